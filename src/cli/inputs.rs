//! The audio files that a command works on.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use anyhow::Context;

use super::console::{Usage, note};

/// Extensions of the audio files in a folder; a single file is recognised by its bytes.
const EXTENSIONS: [&str; 16] = [
    "wav", "aif", "aiff", "aifc", "flac", "mp3", "ogg", "oga", "opus", "webm", "mka", "mkv", "m4a",
    "mp4", "mov", "3gp",
];
/// Folders within folders that are looked at: more are a circle of links.
const DEEPEST: usize = 32;

/// An audio file, and the folder below the given one in which it was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Input {
    pub(super) path: PathBuf,
    pub(super) below: PathBuf,
}

impl Input {
    /// A file that is named itself.
    pub(super) fn of(path: &Path) -> Self {
        Self { path: path.to_owned(), below: PathBuf::new() }
    }
}

/// Lists the files of `inputs`; a folder stands for the audio files inside it, by name: those
/// directly inside it, or those of its sub-folders too if `recursive`. How many files of a folder
/// are left out is said.
pub(super) fn audio_files(inputs: &[PathBuf], recursive: bool) -> anyhow::Result<Vec<Input>> {
    let mut files = Vec::new();
    for input in inputs {
        if !input.is_dir() {
            files.push(Input::of(input));
            continue;
        }
        let depth = if recursive { DEEPEST } else { 0 };
        let mut found = Found::default();
        list(input, Path::new(""), depth, &mut found)?;
        if found.songs.is_empty() {
            let accepted = EXTENSIONS.join(", ");
            let deeper = if recursive { "" } else { "; sub-folders need --recursive" };
            let folder = input.display();
            let problem = format!("{folder} holds no audio file ({accepted}){deeper}");
            return Err(Usage(problem).into());
        }
        if found.others > 0 {
            note(&format!("{}: files of other kinds skipped: {}", input.display(), found.others));
        }
        files.append(&mut found.songs);
    }
    Ok(files)
}

/// What a folder holds.
#[derive(Default)]
struct Found {
    songs: Vec<Input>,
    others: usize,
}

fn list(folder: &Path, below: &Path, depth: usize, found: &mut Found) -> anyhow::Result<()> {
    let entries = fs::read_dir(folder).and_then(|entries| {
        let paths = entries.map(|entry| Ok(entry?.path()));
        paths.collect::<io::Result<Vec<PathBuf>>>()
    });
    let mut entries = entries.with_context(|| folder.display().to_string())?;
    entries.sort();
    for path in entries.iter().filter(|path| path.is_file()) {
        match is_audio(path) {
            true => found.songs.push(Input { path: path.clone(), below: below.to_owned() }),
            false => found.others += 1,
        }
    }
    for path in entries.iter().filter(|path| depth > 0 && path.is_dir()) {
        list(path, &below.join(path.file_name().unwrap_or_default()), depth - 1, found)?;
    }
    Ok(())
}

fn is_audio(file: &Path) -> bool {
    let extension = file.extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|e| EXTENSIONS.contains(&e.to_ascii_lowercase().as_str()))
}
