//! Which audio files a command works on.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::Context;

use super::Usage;

/// Extensions of the files that are taken from a folder; single files are told by their bytes.
const EXTENSIONS: [&str; 7] = ["wav", "flac", "mp3", "ogg", "oga", "m4a", "mp4"];

/// The files named by `inputs`; a folder stands for the audio files directly inside it, by name.
pub(super) fn audio_files(inputs: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for input in inputs {
        if !input.is_dir() {
            files.push(input.clone());
            continue;
        }
        let found = folder(input)?;
        if found.is_empty() {
            let accepted = EXTENSIONS.join(", ");
            let problem = format!("{} holds no audio file ({accepted})", input.display());
            return Err(Usage(problem).into());
        }
        files.extend(found);
    }
    Ok(files)
}

fn folder(path: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(path).with_context(|| path.display().to_string())? {
        let file = entry.with_context(|| path.display().to_string())?.path();
        let extension = file
            .extension()
            .and_then(|e| e.to_str())
            .map(str::to_ascii_lowercase);
        if file.is_file() && extension.is_some_and(|e| EXTENSIONS.contains(&e.as_str())) {
            found.push(file);
        }
    }
    found.sort();
    Ok(found)
}
