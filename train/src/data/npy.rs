//! `.npy` files of joint positions. The declared shape is compared with the bytes that are there
//! before anything is allocated.

use std::path::Path;

use bailando::motion::Positions;

use super::{DataError, JOINTS, files, skeletons};

/// An array of numbers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NpyArray {
    pub(super) shape: Vec<usize>,
    /// In C order.
    pub(super) values: Vec<f32>,
}

/// Reads `[T, 24, 3]` (or `[T, 72]`), or SMPL-H's `[T, 52, 3]` (or `[T, 156]`), of little-endian
/// float32 or float64.
pub(super) fn positions(path: &Path) -> Result<Positions, DataError> {
    let bytes = files::read(path)?;
    parse(&bytes).map_err(|what| DataError::Shape { path: path.to_owned(), what })
}

fn parse(bytes: &[u8]) -> Result<Positions, String> {
    let array = array(bytes, false)?;
    let layout = skeletons::layout(&array.shape);
    let places = layout.and_then(|(_, joints)| skeletons::smpl_joints(joints));
    let (Some((frames, joints)), Some(places)) = (layout, places) else {
        let expected = "[frames, 24, 3] of SMPL, or [frames, 52, 3] of SMPL-H";
        return Err(skeletons::refusal("shape", &array.shape, expected));
    };
    let frames_of = array.values.chunks_exact(3 * joints);
    let points = frames_of.flat_map(|pose| places.map(|place| pose.get(3 * place..3 * place + 3)));
    let values = points.flatten().flatten().copied().collect();
    Positions::from_shape_vec((frames, JOINTS, 3), values).map_err(|error| error.to_string())
}

/// Reads an array of little-endian float32 or float64 of any shape; on request of int32 and int64
/// too.
pub(super) fn array(bytes: &[u8], integers: bool) -> Result<NpyArray, String> {
    let (header, values) = split(bytes).ok_or("this is no whole .npy file")?;
    let (width, number): (usize, fn(&[u8]) -> f32) = match field(header, "descr") {
        Some("'<f4'") => (4, |raw| value(raw, f32::from_le_bytes)),
        Some("'<f8'") => (8, |raw| value(raw, |raw| f64::from_le_bytes(raw) as f32)),
        Some("'<i4'") if integers => (4, |raw| value(raw, |raw| i32::from_le_bytes(raw) as f32)),
        Some("'<i8'") if integers => (8, |raw| value(raw, |raw| i64::from_le_bytes(raw) as f32)),
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
    let declared = shape.iter().try_fold(width, |bytes: usize, &size| bytes.checked_mul(size));
    if declared != Some(values.len()) {
        return Err(format!(
            "the shape {shape:?} is declared, but {} bytes of values are there: the file is \
             damaged or cut off",
            values.len()
        ));
    }
    Ok(NpyArray { shape, values: values.chunks_exact(width).map(number).collect() })
}

/// A number of as many bytes; NaN where there are others.
fn value<const N: usize>(raw: &[u8], number: impl Fn([u8; N]) -> f32) -> f32 {
    raw.try_into().map_or(f32::NAN, number)
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
    fn the_body_of_smpl_h_is_taken() {
        let values: Vec<u8> = (0..312).flat_map(|i| (i as f32).to_le_bytes()).collect();
        for shape in ["(2, 52, 3)", "(2, 156)"] {
            let read = parse(&file("<f4", shape, &values)).unwrap();
            assert_eq!(read.dim(), (2, 24, 3));
            assert_eq!(read[[1, 21, 2]], 156.0 + 3.0 * 21.0 + 2.0);
            // Hands are where the middle fingers begin.
            assert_eq!([read[[0, 22, 0]], read[[0, 23, 0]]], [75.0, 120.0]);
        }
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let values = [0; 288];
        for (bytes, expected) in [
            (file("<f4", "(2, 24, 3)", &values), "cut off"),
            (file("<f4", "(99999999999, 24, 3)", &values), "cut off"),
            (file("<f4", "(1, 24, 3)", &values[..287]), "[1, 24, 3]"),
            (file("<f4", "(1, 22, 3)", &values[..264]), "22 joints are those of SMPL's body"),
            (file("<f4", "(1, 17, 3)", &values[..204]), "17 joints are those of COCO"),
            (file("<f4", "(1, 51)", &values[..204]), "17 joints are those of COCO"),
            (file("<f4", "(1, 165)", &[0; 660]), "55 joints are those of SMPL-X"),
            (file("<f4", "(8, 9)", &values), "[frames, 24, 3] of SMPL"),
            (file("<i8", "(1, 24, 3)", &values), "'<i8'"),
            (b"\x93NUMPY\x01\x00\xff\xff".to_vec(), "no whole .npy"),
            (Vec::new(), "no whole .npy"),
        ] {
            let problem = parse(&bytes).unwrap_err();
            assert!(problem.contains(expected), "{problem}");
        }
    }
}
