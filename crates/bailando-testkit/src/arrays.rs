//! Arrays of NumPy files, and how close they are.

use std::{ops::Range, path::Path};

use ndarray::{Array, Array1, Array2, ArrayView2, Axis, Dimension, Slice};
use ndarray_npy::{ReadableElement, read_npy};

/// Reads an array of the expected element type and dimension.
#[must_use]
pub fn load<T: ReadableElement, D: Dimension>(path: &Path) -> Array<T, D> {
    read_npy(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Reads a float32 matrix.
#[must_use]
pub fn floats(path: &Path) -> Array2<f32> {
    load(path)
}

/// Reads pose codes, stored as int64.
#[must_use]
pub fn codes(path: &Path) -> Vec<u32> {
    let codes: Array1<i64> = load(path);
    codes.mapv(|code| u32::try_from(code).unwrap()).to_vec()
}

/// Returns some rows of a matrix.
#[must_use]
pub fn rows(matrix: &Array2<f32>, range: Range<usize>) -> ArrayView2<'_, f32> {
    matrix.slice_axis(Axis(0), Slice::from(range))
}

/// Fails where two matrices differ by more than `tolerance`, and says by how much.
#[track_caller]
pub fn assert_close(found: &Array2<f32>, expected: &Array2<f32>, tolerance: f32, what: &str) {
    assert_eq!(found.dim(), expected.dim(), "{what}: shape");
    let differences = found.iter().zip(expected).map(|(a, b)| (a - b).abs());
    let worst = differences.fold(0.0_f32, f32::max);
    assert!(worst <= tolerance, "{what}: differs by {worst:e}");
}
