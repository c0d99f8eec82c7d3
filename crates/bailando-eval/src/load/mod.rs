//! Motions from files: NumPy arrays, our JSON and our BVH.

mod bvh;
mod json;
mod npy;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use ndarray::Array3;

use crate::{
    body::Motion,
    error::EvaluationError,
    files::{entries, stem, text},
};

/// Ending of files of pose codes.
const CODES: &str = ".codes.npy";

/// How a motion is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Npy,
    Json,
    Bvh,
}

impl Kind {
    fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "npy" => Some(Self::Npy),
            "json" => Some(Self::Json),
            "bvh" => Some(Self::Bvh),
            _ => None,
        }
    }
}

/// Reads a motion: `.npy` (`[frames, 24, 3]`, metres), `.json` or `.bvh` as this program writes
/// them. Its name is the file's stem.
///
/// # Errors
/// [`EvaluationError`] names the file and what is wrong with it.
pub fn load_motion(path: &Path) -> Result<Motion, EvaluationError> {
    let made = |positions: Array3<f32>| match Motion::new(&stem(path), positions.view()) {
        // The path says which one.
        Err(EvaluationError::Motion { problem, .. }) => Err(problem),
        made => made.map_err(|error| error.to_string()),
    };
    let motion = match Kind::of(path) {
        Some(Kind::Npy) => npy::read(path).and_then(made),
        Some(Kind::Json) => json::read(&text(path)?)
            .and_then(|(positions, codes)| Ok(made(positions)?.with_codes(codes))),
        Some(Kind::Bvh) => bvh::read(&text(path)?)
            .and_then(|(positions, rotations)| Ok(made(positions)?.with_rotations(rotations))),
        None => Err("a motion is a .npy, .json or .bvh file".into()),
    };
    motion.map_err(|problem| EvaluationError::file(path, problem))
}

/// Lists the motion files of a folder, by name; `index.json` is none, nor are the codes that
/// `bailando-train encode` writes beside its motions.
///
/// # Errors
/// [`EvaluationError`] if the folder can't be read, or two files have one stem.
pub(crate) fn motion_files(folder: &Path) -> Result<Vec<PathBuf>, EvaluationError> {
    let mut files: BTreeMap<String, PathBuf> = BTreeMap::new();
    for path in entries(folder)? {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_other = name == "index.json" || name.ends_with(CODES);
        if is_other || Kind::of(&path).is_none() || !path.is_file() {
            continue;
        }
        if let Some(other) = files.insert(stem(&path), path.clone()) {
            let problem = format!("{} is a motion of the same piece", other.display());
            return Err(EvaluationError::file(&path, problem));
        }
    }
    Ok(files.into_values().collect())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_folder_has_one_motion_per_stem() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        for name in ["b.npy", "a.bvh", "b.codes.npy", "index.json", "song.ogg"] {
            fs::write(file(name), "").unwrap();
        }
        let found = motion_files(folder.path()).unwrap();
        assert_eq!(found, [file("a.bvh"), file("b.npy")]);
        fs::write(file("a.json"), "{}").unwrap();
        let message = motion_files(folder.path()).unwrap_err().to_string();
        assert!(message.contains("same piece"), "{message}");
    }

    #[test]
    fn errors_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wrong.npy");
        ndarray_npy::write_npy(&path, &Array3::<f32>::zeros((10, 22, 3))).unwrap();
        for (path, words) in [
            (path, ["wrong.npy", "[10, 22, 3]"]),
            (folder.path().join("none.bvh"), ["none.bvh", ""]),
        ] {
            let message = load_motion(&path).unwrap_err().to_string();
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
    }
}
