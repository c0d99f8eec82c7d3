//! Files that are replaced in one step.

use std::{
    fs::{self, File},
    io::{self, Write},
    path::Path,
};

/// Extension of a file while it is written.
const PARTIAL: &str = "partial";

/// Writes beside `path`, then takes its place: after a kill the old file or the new one is there.
pub(super) fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let partial = path.with_extension(PARTIAL);
    let mut file = File::create(&partial)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&partial, path)
}

/// Removes the files of a folder that a kill left half written.
pub(super) fn remove_partial(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == PARTIAL) {
            fs::remove_file(path)?;
        }
    }
    Ok(())
}

/// Turns the error of a missing file into `None`; other errors stay errors.
pub(super) fn if_present<T>(read: io::Result<T>) -> io::Result<Option<T>> {
    match read {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_written_files_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("loss.svg");
        replace_file(&path, b"whole").unwrap();
        fs::write(folder.path().join("best.partial"), b"ha").unwrap();
        remove_partial(folder.path()).unwrap();
        let left: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
        assert_eq!(left.len(), 1);
        assert_eq!(fs::read(&path).unwrap(), b"whole");
    }

    #[test]
    fn only_a_missing_file_is_no_error() {
        let folder = tempfile::tempdir().unwrap();
        let missing = if_present(fs::read(folder.path().join("nothing")));
        assert!(missing.unwrap().is_none());
        assert!(if_present(fs::read(folder.path())).is_err());
    }
}
