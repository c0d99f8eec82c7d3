//! Tiny models with random weights. `train/tests/tiny_models.rs` writes them and keeps them true.

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde_json::Value;
use tempfile::TempDir;

/// Returns the directory of the golden checkpoints' model: as published, weights in float32.
#[must_use]
pub fn tiny() -> PathBuf {
    crate::fixture("model/tiny")
}

/// Returns the directory of a model with all that was added to the published one: motion in the
/// dancer's frame, counts beside the features, suppressed codes, start codes, candidates that are
/// chosen from, weights in 8 bits.
#[must_use]
pub fn tiny_dancer() -> PathBuf {
    crate::fixture("model/tiny_dancer")
}

/// Returns the directory of a model that knows three styles, energies and counts, and has a
/// classifier of songs: the mean of feature column 0 is high in house, of 1 in krump, of 2 in lock.
#[must_use]
pub fn tiny_styles() -> PathBuf {
    crate::fixture("model/tiny_styles")
}

/// Copies a model directory and changes the copy's manifest; the copy vanishes with the guard.
#[must_use]
pub fn changed(model: &Path, change: impl FnOnce(&mut Value)) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for entry in fs::read_dir(model).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), folder.path().join(entry.file_name())).unwrap();
    }
    let path = folder.path().join("manifest.json");
    let mut manifest = crate::read_json(&path);
    change(&mut manifest);
    fs::write(&path, manifest.to_string()).unwrap();
    folder
}
