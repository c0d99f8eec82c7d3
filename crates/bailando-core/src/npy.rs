//! NumPy files from untrusted sources: no header makes the reader allocate.

use ndarray::{Array, ArrayView, Dimension};
use ndarray_npy::{ViewElement, ViewNpyError, ViewNpyExt};

/// Bytes before a header's length: magic string and version.
const PREFIX: usize = 8;

/// Reads the array in the bytes of a `.npy` file.
///
/// The sizes that the header declares are compared with the length of `bytes` first;
/// `ndarray_npy`'s reader of whole arrays allocates them, true or not.
///
/// # Errors
/// [`ViewNpyError`] for another type or number of dimensions, and for a damaged or truncated file.
///
/// ```
/// use bailando_core::npy::read_array;
/// use ndarray::{Ix1, array};
/// use ndarray_npy::WriteNpyExt;
///
/// let mut bytes = Vec::new();
/// array![1.0_f32, 2.0].write_npy(&mut bytes)?;
/// assert_eq!(read_array::<f32, Ix1>(&bytes)?, array![1.0, 2.0]);
/// assert!(read_array::<f32, Ix1>(&bytes[..80]).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_array<A, D>(bytes: &[u8]) -> Result<Array<A, D>, ViewNpyError>
where
    A: ViewElement + Clone,
    D: Dimension,
{
    check_header_length(bytes)?;
    Ok(ArrayView::<A, D>::view_npy(bytes)?.to_owned())
}

/// Refuses a header that declares more bytes for itself than follow: up to 4 GiB from version 2 on.
fn check_header_length(bytes: &[u8]) -> Result<(), ViewNpyError> {
    let after = bytes.get(PREFIX..).unwrap_or_default();
    let Some((length, rest)) = after.split_first_chunk::<4>() else {
        return Ok(());
    };
    let is_first_version = bytes.get(PREFIX - 2) == Some(&1);
    let missing = (u32::from_le_bytes(*length) as usize).saturating_sub(rest.len());
    if is_first_version || missing == 0 {
        return Ok(());
    }
    Err(ViewNpyError::MissingBytes(missing))
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, Array3, ShapeBuilder};
    use ndarray_npy::WriteNpyExt;

    use super::*;

    /// A file of any version with any header.
    fn file(version: u8, header: &str, values: &[u8]) -> Vec<u8> {
        let length = (header.len() as u32).to_le_bytes();
        let length = if version == 1 { &length[..2] } else { &length };
        let version = [version, 0];
        [&b"\x93NUMPY"[..], &version, length, header.as_bytes(), values].concat()
    }

    fn declaring(shape: &str) -> String {
        let head = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
        // Values begin at a multiple of 64 bytes, as NumPy pads them.
        format!("{head:<117}\n")
    }

    #[test]
    fn arrays_are_read_in_either_order() {
        for rows in [
            Array2::from_shape_fn((3, 2), |(i, j)| (2 * i + j) as i64),
            Array2::from_shape_fn((3, 2).f(), |(i, j)| (2 * i + j) as i64),
        ] {
            let mut bytes = Vec::new();
            rows.write_npy(&mut bytes).unwrap();
            assert_eq!(read_array::<i64, _>(&bytes).unwrap(), rows);
            assert!(read_array::<f32, ndarray::Ix2>(&bytes).is_err());
            assert!(read_array::<i64, ndarray::Ix3>(&bytes).is_err());
        }
    }

    #[test]
    fn a_file_shorter_than_its_header_declares_is_refused() {
        let one = [0; 4];
        let read = |bytes: &[u8]| read_array::<f32, ndarray::Ix3>(bytes);
        let good = file(1, &declaring("(1, 1, 1)"), &one);
        assert_eq!(read(&good).unwrap(), Array3::<f32>::zeros((1, 1, 1)));
        for first in ["1099511627776", "18446744073709551615", "2"] {
            let shape = format!("({first}, 1, 1)");
            assert!(read(&file(1, &declaring(&shape), &one)).is_err(), "{shape}");
        }
        let mut long = file(2, &declaring("(1, 1, 1)"), &one);
        long[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
        let refused = read(&long);
        assert!(matches!(refused, Err(ViewNpyError::MissingBytes(_))));
        for length in 0..good.len() {
            assert!(read(&good[..length]).is_err(), "{length} bytes");
        }
    }
}
