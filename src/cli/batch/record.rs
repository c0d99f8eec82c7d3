//! With which options the dances of a folder were made: a line for each, so that a batch with other
//! options knows which dances it keeps.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::{ErrorKind, Write},
    path::{Path, PathBuf},
    sync::Mutex,
};

use anyhow::Context;
use serde::{Deserialize, Serialize};

/// The file in the folder of the dances.
const FILE: &str = "made.jsonl";

/// Lines of earlier batches, and of this one.
pub(super) struct Record {
    folder: PathBuf,
    options: String,
    earlier: HashMap<String, String>,
    file: Mutex<File>,
}

#[derive(Serialize, Deserialize)]
struct Line {
    dance: String,
    options: String,
}

impl Record {
    /// Reads what earlier batches noted in `folder`, for one with these options.
    pub(super) fn open(folder: &Path, options: String) -> anyhow::Result<Self> {
        let path = folder.join(FILE);
        let named = || path.display().to_string();
        let text = match fs::read_to_string(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
            read => read.with_context(named)?,
        };
        // The last line of a batch that was killed may be cut.
        let lines = text.lines().filter_map(|line| serde_json::from_str::<Line>(line).ok());
        let earlier = lines.map(|Line { dance, options }| (dance, options)).collect();
        let file = File::options().append(true).create(true).open(&path).with_context(named)?;
        Ok(Self { folder: folder.to_path_buf(), options, earlier, file: Mutex::new(file) })
    }

    fn name(&self, dance: &Path) -> String {
        dance.strip_prefix(&self.folder).unwrap_or(dance).display().to_string()
    }

    /// Whether a dance is known to be made with other options.
    pub(super) fn differs(&self, dance: &Path) -> bool {
        self.earlier.get(&self.name(dance)).is_some_and(|options| *options != self.options)
    }

    /// Notes a dance that is about to appear.
    pub(super) fn note(&self, dance: &Path) -> anyhow::Result<()> {
        let line = Line { dance: self.name(dance), options: self.options.clone() };
        let line = format!("{}\n", serde_json::to_string(&line)?);
        let Ok(mut file) = self.file.lock() else { anyhow::bail!("a thread of the batch died") };
        file.write_all(line.as_bytes()).with_context(|| FILE.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dances_of_other_options_are_known_also_after_a_cut() {
        let folder = tempfile::tempdir().unwrap();
        let dances = ["a.bvh", "below/a.bvh", "b.bvh"].map(|name| folder.path().join(name));
        let open = |options: &str| Record::open(folder.path(), options.to_owned()).unwrap();
        let first = open("seed=1");
        for dance in &dances[..2] {
            first.note(dance).unwrap();
        }
        let path = folder.path().join(FILE);
        let cut = fs::read_to_string(&path).unwrap() + "{\"dance\":";
        fs::write(&path, cut).unwrap();
        let differs = |options: &str| dances.each_ref().map(|dance| open(options).differs(dance));
        assert_eq!(differs("seed=1"), [false; 3]);
        assert_eq!(differs("seed=2"), [true, true, false]);
    }
}
