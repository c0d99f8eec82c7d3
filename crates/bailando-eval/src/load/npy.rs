//! Positions as a NumPy file.

use std::{fs, path::Path};

use ndarray::Array3;
use ndarray_npy::ViewNpyError;

use bailando_core::npy::read_array;

/// Reads positions `[frames, 24, 3]`, float32 or NumPy's default float64.
pub(super) fn read(path: &Path) -> Result<Array3<f32>, String> {
    let bytes = fs::read(path).map_err(|error| error.to_string())?;
    let positions = match read_array(&bytes) {
        Err(ViewNpyError::WrongDescriptor(_)) => {
            read_array(&bytes).map(|positions: Array3<f64>| positions.mapv(|value| value as f32))
        }
        read => read,
    };
    positions.map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("motion.npy");
        (folder, path)
    }

    #[test]
    fn both_precisions_are_read_and_integers_are_not() {
        let (_folder, path) = file();
        let expected = Array3::from_elem((4, 24, 3), 1.5_f32);
        ndarray_npy::write_npy(&path, &expected).unwrap();
        assert_eq!(read(&path).unwrap(), expected);
        ndarray_npy::write_npy(&path, &expected.mapv(f64::from)).unwrap();
        assert_eq!(read(&path).unwrap(), expected);
        ndarray_npy::write_npy(&path, &expected.mapv(|v| v as i32)).unwrap();
        assert!(read(&path).is_err());
    }

    #[test]
    fn a_header_that_declares_more_than_there_is_is_refused() {
        let (_folder, path) = file();
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 24, 3), }";
        let header = format!("{header:<117}\n");
        let bytes = [b"\x93NUMPY\x01\x00\x76\x00", header.as_bytes()].concat();
        fs::write(&path, bytes).unwrap();
        let problem = read(&path).unwrap_err();
        assert!(problem.contains("missing"), "{problem}");
    }
}
