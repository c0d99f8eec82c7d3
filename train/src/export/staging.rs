//! A directory that is written under another name and takes its place in one step.

use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

use bailando::model::FileEntry;

use super::ExportError;
use crate::sha256;

/// The file that marks a model directory.
const MANIFEST: &str = "manifest.json";

/// A directory under construction; dropped before it is published, it vanishes.
#[derive(Debug)]
pub(super) struct Staging {
    target: PathBuf,
    folder: PathBuf,
    retired: PathBuf,
}

impl Staging {
    /// Starts beside `target`, so that taking its place is a rename within one file system.
    pub(super) fn beside(target: &Path, replace: bool) -> Result<Self, ExportError> {
        check_target(target, replace)?;
        let name = target.file_name();
        let name = name.ok_or_else(|| ExportError::NoName(target.to_owned()))?;
        let sibling = |purpose: &str| {
            let process = std::process::id();
            let name = name.to_string_lossy();
            target.with_file_name(format!(".{name}.{purpose}-{process}"))
        };
        let staging =
            Self { folder: sibling("new"), retired: sibling("old"), target: target.to_owned() };
        if let Some(parent) = target.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            fs::create_dir_all(parent).map_err(failed(parent))?;
        }
        let folder = &staging.folder;
        // A container gives every process the same number: what is there is of one that was killed.
        if folder.exists() {
            fs::remove_dir_all(folder).map_err(failed(folder))?;
        }
        fs::create_dir(folder).map_err(failed(folder))?;
        Ok(staging)
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes one file and says what the manifest should.
    pub(super) fn write(&mut self, name: &str, bytes: &[u8]) -> Result<FileEntry, ExportError> {
        let path = self.folder.join(name);
        let write = || -> io::Result<FileEntry> {
            let mut file = File::create(&path)?;
            file.write_all(bytes)?;
            file.sync_all()?;
            Ok(FileEntry { bytes: bytes.len() as u64, sha256: sha256(bytes) })
        };
        write().map_err(failed(&path))
    }

    /// Takes the target's place, keeping files of the old directory that the new one lacks.
    pub(super) fn publish(self) -> Result<(), ExportError> {
        let (target, folder, retired) = (&self.target, &self.folder, &self.retired);
        if target.exists() {
            fs::rename(target, retired).map_err(failed(target))?;
            if let Err(source) = fs::rename(folder, target) {
                // Put the old one back; if even that fails it is still there under the other name.
                let _ = fs::rename(retired, target);
                return Err(failed(target)(source));
            }
            keep_other_files(retired, target)?;
            fs::remove_dir_all(retired).map_err(failed(retired))
        } else {
            fs::rename(folder, target).map_err(failed(target))
        }
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // Already gone when it was published; a leftover is harmless and its name says what it is.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Refuses a place where a model cannot be written.
pub(crate) fn check_target(target: &Path, replace: bool) -> Result<(), ExportError> {
    if !target.exists() {
        return Ok(());
    }
    if !replace {
        return Err(ExportError::Exists(target.to_owned()));
    }
    if target.join(MANIFEST).is_file() {
        return Ok(());
    }
    let empty = target.is_dir() && fs::read_dir(target).map_err(failed(target))?.next().is_none();
    if empty { Ok(()) } else { Err(ExportError::NotAModel(target.to_owned())) }
}

fn keep_other_files(from: &Path, to: &Path) -> Result<(), ExportError> {
    for entry in fs::read_dir(from).map_err(failed(from))? {
        let entry = entry.map_err(failed(from))?;
        let kept = to.join(entry.file_name());
        if !kept.exists() {
            fs::rename(entry.path(), &kept).map_err(failed(&kept))?;
        }
    }
    Ok(())
}

fn failed(path: &Path) -> impl Fn(io::Error) -> ExportError {
    let path = path.to_owned();
    move |source| ExportError::Write { path: path.clone(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn publish(target: &Path, replace: bool, content: &str) -> Result<(), ExportError> {
        let mut staging = Staging::beside(target, replace)?;
        staging.write(MANIFEST, content.as_bytes())?;
        staging.publish()
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_model_is_replaced_only_when_asked_and_keeps_its_card() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("model");
        publish(&target, false, "one").unwrap();
        fs::write(target.join("MODEL_CARD.md"), "card").unwrap();
        assert!(matches!(publish(&target, false, "two"), Err(ExportError::Exists(_))));
        publish(&target, true, "three").unwrap();
        assert_eq!(fs::read_to_string(target.join(MANIFEST)).unwrap(), "three");
        assert_eq!(names(&target), ["MODEL_CARD.md", MANIFEST]);
        assert_eq!(names(folder.path()), ["model"]);
    }

    #[test]
    fn other_directories_are_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("thesis.tex"), "years of work").unwrap();
        let refused = publish(folder.path(), true, "x");
        assert!(matches!(refused, Err(ExportError::NotAModel(_))));
        assert_eq!(names(folder.path()), ["thesis.tex"]);
    }

    #[test]
    fn what_a_killed_write_left_is_in_nobodys_way() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("model");
        let mut killed = Staging::beside(&target, false).unwrap();
        killed.write("half", b"ha").unwrap();
        std::mem::forget(killed);
        publish(&target, false, "one").unwrap();
        assert_eq!(names(&target), [MANIFEST]);
        assert_eq!(names(folder.path()), ["model"]);
    }

    #[test]
    fn an_abandoned_write_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("model");
        let mut staging = Staging::beside(&target, false).unwrap();
        let entry = staging.write("a", b"abc").unwrap();
        assert_eq!(entry.bytes, 3);
        assert!(entry.sha256.starts_with("ba7816bf"));
        drop(staging);
        assert_eq!(names(folder.path()), [""; 0]);
    }
}
