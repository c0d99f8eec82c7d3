//! `.npy` files of joint positions. The declared shape is compared with the bytes that are there
//! before anything is allocated.

use std::path::Path;

use bailando::motion::Positions;

use super::{DataError, JOINTS, files};

/// Reads `[T, 24, 3]` (or `[T, 72]`) of little-endian float32 or float64.
pub(super) fn positions(path: &Path) -> Result<Positions, DataError> {
    let bytes = files::read(path)?;
    parse(&bytes).map_err(|what| DataError::Shape { path: path.to_owned(), what })
}

fn parse(bytes: &[u8]) -> Result<Positions, String> {
    let (header, values) = split(bytes).ok_or("this is no whole .npy file")?;
    let wide = match field(header, "descr") {
        Some("'<f4'") => false,
        Some("'<f8'") => true,
        other => {
            return Err(format!(
                "holds {} values, expected '<f4' (float32)",
                other.unwrap_or("unknown")
            ));
        }
    };
    if field(header, "fortran_order") != Some("False") {
        return Err("is stored column by column; save it with numpy.ascontiguousarray".into());
    }
    let shape = shape(header).ok_or("its header names no shape")?;
    let frames = match *shape.as_slice() {
        [frames, JOINTS, 3] => frames,
        [frames, columns] if columns == 3 * JOINTS => frames,
        _ => return Err(format!("shape {shape:?}, expected [frames, {JOINTS}, 3]")),
    };
    let width = if wide { 8 } else { 4 };
    let expected = frames.checked_mul(3 * JOINTS * width);
    if expected != Some(values.len()) {
        return Err(format!(
            "{frames} frames are declared, but {} bytes of values are there: the file is damaged \
             or cut off",
            values.len()
        ));
    }
    let values = if wide {
        chunks::<8>(values).map(|chunk| f64::from_le_bytes(chunk) as f32).collect()
    } else {
        chunks::<4>(values).map(f32::from_le_bytes).collect()
    };
    Positions::from_shape_vec((frames, JOINTS, 3), values).map_err(|error| error.to_string())
}

fn chunks<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> {
    bytes.chunks_exact(N).filter_map(|chunk| chunk.try_into().ok())
}

/// Header text and values.
fn split(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let rest = bytes.strip_prefix(b"\x93NUMPY")?;
    let (&[major, _minor], rest) = rest.split_first_chunk::<2>()?;
    let (length, rest) = if major == 1 {
        let (length, rest) = rest.split_first_chunk::<2>()?;
        (usize::from(u16::from_le_bytes(*length)), rest)
    } else {
        let (length, rest) = rest.split_first_chunk::<4>()?;
        (usize::try_from(u32::from_le_bytes(*length)).ok()?, rest)
    };
    let (header, values) = rest.split_at_checked(length)?;
    Some((std::str::from_utf8(header).ok()?, values))
}

/// The value beside `key` in a header like `{'descr': '<f4', 'fortran_order': False, ..}`.
fn field<'h>(header: &'h str, key: &str) -> Option<&'h str> {
    let (_, value) = header.split_once(&format!("'{key}':"))?;
    Some(value.split([',', '}']).next()?.trim())
}

fn shape(header: &str) -> Option<Vec<usize>> {
    let (_, shape) = header.split_once("'shape':")?;
    let (shape, _) = shape.trim_start().strip_prefix('(')?.split_once(')')?;
    let sizes = shape.split(',').map(str::trim).filter(|size| !size.is_empty());
    sizes.map(|size| size.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(descr: &str, shape: &str, values: &[u8]) -> Vec<u8> {
        let header =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let length = u16::try_from(header.len()).unwrap().to_le_bytes();
        [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), values].concat()
    }

    #[test]
    fn both_widths_and_both_shapes_are_read() {
        let narrow: Vec<u8> = (0..144).flat_map(|i| (i as f32).to_le_bytes()).collect();
        let wide: Vec<u8> = (0..144).flat_map(|i| f64::from(i).to_le_bytes()).collect();
        let read = parse(&file("<f4", "(2, 24, 3)", &narrow)).unwrap();
        assert_eq!(read[[1, 2, 1]], 72.0 + 6.0 + 1.0);
        assert_eq!(parse(&file("<f8", "(2, 72)", &wide)).unwrap(), read);
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let values = [0; 288];
        for (bytes, expected) in [
            (file("<f4", "(2, 24, 3)", &values), "cut off"),
            (file("<f4", "(99999999999, 24, 3)", &values), "cut off"),
            (file("<f4", "(1, 22, 3)", &values), "[1, 22, 3]"),
            (file("<i8", "(1, 24, 3)", &values), "'<i8'"),
            (b"\x93NUMPY\x01\x00\xff\xff".to_vec(), "no whole .npy"),
            (Vec::new(), "no whole .npy"),
        ] {
            let problem = parse(&bytes).unwrap_err();
            assert!(problem.contains(expected), "{problem}");
        }
    }
}
