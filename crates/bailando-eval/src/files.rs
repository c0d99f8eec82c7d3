//! Text files and folders, with errors that name them.

use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::error::EvaluationError;

/// Lists the contents of a folder, by name.
pub(crate) fn entries(folder: &Path) -> Result<Vec<PathBuf>, EvaluationError> {
    let paths = fs::read_dir(folder).and_then(|entries| {
        let paths = entries.map(|entry| Ok(entry?.path()));
        paths.collect::<Result<Vec<_>, _>>()
    });
    let mut paths = paths.map_err(EvaluationError::io(folder))?;
    paths.sort();
    Ok(paths)
}

/// Reads a text file.
pub(crate) fn text(path: &Path) -> Result<String, EvaluationError> {
    fs::read_to_string(path).map_err(EvaluationError::io(path))
}

/// Returns a file's name without its extension.
pub(crate) fn stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}
