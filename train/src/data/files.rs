//! Reading whole files within a bound, and listing folders in a fixed order.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use super::DataError;

/// Largest file that is read whole: an hour of motion in float64 has 0.25 GB, a song far less.
const MAX_BYTES: u64 = 1 << 30;

pub(super) fn read(path: &Path) -> Result<Vec<u8>, DataError> {
    read_at_most(path, MAX_BYTES)
}

pub(super) fn read_at_most(path: &Path, limit: u64) -> Result<Vec<u8>, DataError> {
    let bytes = fs::metadata(path).map_err(failed(path))?.len();
    if bytes > limit {
        return Err(DataError::TooLarge { path: path.to_owned(), bytes, limit });
    }
    fs::read(path).map_err(failed(path))
}

/// Files and folders inside `folder`, by name, without hidden ones.
pub(super) fn list(folder: &Path) -> Result<Vec<PathBuf>, DataError> {
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed(folder))? {
        let entry = entry.map_err(failed(folder))?;
        if !entry.file_name().to_string_lossy().starts_with('.') {
            paths.push(entry.path());
        }
    }
    paths.sort();
    Ok(paths)
}

pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let found = path.extension().and_then(|extension| extension.to_str());
    found.is_some_and(|found| {
        extensions.iter().any(|extension| found.eq_ignore_ascii_case(extension))
    })
}

/// File name without its ending.
pub(super) fn stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

pub(super) fn failed(path: &Path) -> impl Fn(io::Error) -> DataError {
    let path = path.to_owned();
    move |source| DataError::Read { path: path.clone(), source }
}
