//! The audio files that a command works on.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use anyhow::Context;

use super::console::Usage;

/// Extensions of the audio files in a folder; a single file is recognised by its bytes.
const EXTENSIONS: [&str; 14] = [
    "wav", "aif", "aiff", "aifc", "flac", "mp3", "ogg", "oga", "opus", "webm", "mka", "m4a", "mp4",
    "mov",
];

/// Lists the files of `inputs`; a folder stands for the audio files directly inside it, by name.
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
    let is_audio = |file: &PathBuf| {
        let extension = file.extension().and_then(|e| e.to_str());
        let known = |e: &str| EXTENSIONS.contains(&e.to_ascii_lowercase().as_str());
        file.is_file() && extension.is_some_and(known)
    };
    let files = fs::read_dir(path).and_then(|entries| {
        let files = entries.map(|entry| Ok(entry?.path()));
        files.collect::<io::Result<Vec<PathBuf>>>()
    });
    let mut files = files.with_context(|| path.display().to_string())?;
    files.retain(is_audio);
    files.sort();
    Ok(files)
}
