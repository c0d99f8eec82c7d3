//! Positions as a NumPy file.

use std::path::Path;

use ndarray::Array3;
use ndarray_npy::{ReadNpyError, read_npy};

/// Positions `[frames, 24, 3]`, float32, or float64 as NumPy makes it unasked.
pub(super) fn read(path: &Path) -> Result<Array3<f32>, String> {
    match read_npy::<_, Array3<f32>>(path) {
        Err(ReadNpyError::WrongDescriptor(_)) => read_npy::<_, Array3<f64>>(path)
            .map(|positions| positions.mapv(|value| value as f32))
            .map_err(|error| error.to_string()),
        read => read.map_err(|error| error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_precisions_are_read_and_integers_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("motion.npy");
        let expected = Array3::from_elem((4, 24, 3), 1.5_f32);
        ndarray_npy::write_npy(&path, &expected).unwrap();
        assert_eq!(read(&path).unwrap(), expected);
        ndarray_npy::write_npy(&path, &expected.mapv(f64::from)).unwrap();
        assert_eq!(read(&path).unwrap(), expected);
        ndarray_npy::write_npy(&path, &expected.mapv(|v| v as i32)).unwrap();
        assert!(read(&path).is_err());
    }
}
