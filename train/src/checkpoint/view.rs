//! A strided view of raw bytes to a dense float32 tensor.

use half::{bf16, f16};

use super::{
    error::Problem,
    pickle::{ElementType, TensorView},
};
use crate::host_tensor::{HostTensor, elements};

/// Refuses a view that reaches outside its storage or that is larger than it: weights have one
/// value per element, and a broadcast view of a small storage could ask for any amount of memory.
pub(super) fn check(view: &TensorView) -> Result<(), Problem> {
    let inside = elements(&view.shape).is_some_and(|count| {
        count <= view.storage.values
            && (count == 0 || last_value(view).is_some_and(|last| last < view.storage.values))
    });
    if inside {
        return Ok(());
    }
    Err(Problem::OutsideStorage {
        shape: view.shape.clone(),
        strides: view.strides.clone(),
        offset: view.offset,
        values: view.storage.values,
    })
}

/// Index of the highest value of a view that is not empty.
fn last_value(view: &TensorView) -> Option<usize> {
    let dimensions = view.shape.iter().zip(&view.strides);
    dimensions.into_iter().try_fold(view.offset, |last, (&size, &stride)| {
        last.checked_add((size - 1).checked_mul(stride)?)
    })
}

/// The dense tensor of a view that passed [`check`], from its storage's bytes.
pub(super) fn decode(view: &TensorView, bytes: &[u8]) -> Result<HostTensor, Problem> {
    let element = view.storage.element;
    let convert = converter(element).ok_or(Problem::NotFloat(element.name()))?;
    let count = elements(&view.shape).unwrap_or(0);
    if count == 0 {
        // Offset and strides of nothing may be anything.
        return finish(view, Vec::new());
    }
    // Missing bytes become NaN, which `finish` refuses.
    let mut data = Vec::with_capacity(count);
    if is_dense(view) {
        let dense = bytes.get(view.offset * element.bytes()..).unwrap_or(&[]);
        data.extend(dense.chunks_exact(element.bytes()).take(count).map(convert));
        return finish(view, data);
    }
    let mut index = vec![0; view.shape.len()];
    for _ in 0..count {
        let value = position(view, &index) * element.bytes();
        let raw = bytes.get(value..value + element.bytes());
        data.push(convert(raw.unwrap_or(&[])));
        advance(&mut index, &view.shape);
    }
    finish(view, data)
}

/// Whether the values lie in row-major order without gaps, as almost all do.
fn is_dense(view: &TensorView) -> bool {
    let mut expected = 1;
    view.shape.iter().zip(&view.strides).rev().all(|(&size, &stride)| {
        let dense = size == 1 || stride == expected;
        expected *= size;
        dense
    })
}

fn finish(view: &TensorView, data: Vec<f32>) -> Result<HostTensor, Problem> {
    if !data.iter().all(|value| value.is_finite()) {
        return Err(Problem::NotFinite);
    }
    HostTensor::new(view.shape.clone(), data).map_err(|_| Problem::NotFinite)
}

fn position(view: &TensorView, index: &[usize]) -> usize {
    let steps = index.iter().zip(&view.strides).map(|(i, stride)| i * stride);
    view.offset + steps.sum::<usize>()
}

/// Counts `index` up in row-major order.
fn advance(index: &mut [usize], shape: &[usize]) {
    for (i, &size) in index.iter_mut().zip(shape).rev() {
        *i += 1;
        if *i < size {
            return;
        }
        *i = 0;
    }
}

/// Reads one little-endian value; NaN where bytes are missing. None for types weights don't have.
fn converter(element: ElementType) -> Option<fn(&[u8]) -> f32> {
    fn read<const N: usize>(raw: &[u8], value: impl Fn([u8; N]) -> f32) -> f32 {
        raw.try_into().map_or(f32::NAN, value)
    }
    match element {
        ElementType::F64 => Some(|raw| read(raw, |b| f64::from_le_bytes(b) as f32)),
        ElementType::F32 => Some(|raw| read(raw, f32::from_le_bytes)),
        ElementType::F16 => Some(|raw| read(raw, |b| f16::from_le_bytes(b).to_f32())),
        ElementType::Bf16 => Some(|raw| read(raw, |b| bf16::from_le_bytes(b).to_f32())),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::checkpoint::pickle::Storage;

    fn view(element: ElementType, values: usize, shape: &[usize], strides: &[usize]) -> TensorView {
        TensorView {
            storage: Storage { key: Arc::from("0"), element, values },
            offset: 0,
            shape: shape.to_vec(),
            strides: strides.to_vec(),
        }
    }

    #[test]
    fn strides_are_followed() {
        let bytes: Vec<u8> = (0..6_u8).flat_map(|i| f32::from(i).to_le_bytes()).collect();
        let transposed = view(ElementType::F32, 6, &[3, 2], &[1, 3]);
        check(&transposed).unwrap();
        let tensor = decode(&transposed, &bytes).unwrap();
        assert_eq!(tensor.data(), [0.0, 3.0, 1.0, 4.0, 2.0, 5.0]);
        let mut second_half = view(ElementType::F32, 6, &[3], &[1]);
        second_half.offset = 3;
        assert_eq!(decode(&second_half, &bytes).unwrap().data(), [3.0, 4.0, 5.0]);
    }

    #[test]
    fn every_float_type_is_widened() {
        let value = 1.5_f32;
        let cases: [(ElementType, Vec<u8>); 4] = [
            (ElementType::F64, 1.5_f64.to_le_bytes().to_vec()),
            (ElementType::F32, value.to_le_bytes().to_vec()),
            (ElementType::F16, f16::from_f32(value).to_le_bytes().to_vec()),
            (ElementType::Bf16, bf16::from_f32(value).to_le_bytes().to_vec()),
        ];
        for (element, bytes) in cases {
            let tensor = decode(&view(element, 1, &[1], &[1]), &bytes).unwrap();
            assert_eq!(tensor.data(), [value], "{element:?}");
        }
        let scalar = decode(&view(ElementType::F32, 1, &[], &[]), &value.to_le_bytes());
        assert_eq!(scalar.unwrap().shape(), [0_usize; 0]);
    }

    #[test]
    fn views_outside_their_storage_are_refused() {
        let cases: [(&[usize], &[usize]); 5] = [
            (&[2, 4], &[4, 1]),
            (&[1 << 40], &[0]),
            (&[2], &[6]),
            (&[2, 2], &[usize::MAX, 1]),
            (&[usize::MAX, 2], &[1, 1]),
        ];
        for (shape, strides) in cases {
            assert!(check(&view(ElementType::F32, 6, shape, strides)).is_err(), "{shape:?}");
        }
        assert!(check(&view(ElementType::F32, 6, &[0, 9], &[9, 1])).is_ok());
    }

    #[test]
    fn an_empty_view_may_say_anything_else() {
        const HUGE: usize = 1 << 40;
        let mut empty = view(ElementType::F32, 6, &[0, HUGE, HUGE], &[1, HUGE, 1]);
        empty.offset = usize::MAX / 2;
        check(&empty).unwrap();
        assert!(decode(&empty, &[0; 24]).unwrap().data().is_empty());
    }

    #[test]
    fn integers_and_infinities_are_no_weights() {
        let integers = view(ElementType::I64, 1, &[1], &[1]);
        assert!(matches!(decode(&integers, &[0; 8]), Err(Problem::NotFloat("int64"))));
        let bytes = f32::INFINITY.to_le_bytes();
        let infinite = decode(&view(ElementType::F32, 1, &[1], &[1]), &bytes);
        assert!(matches!(infinite, Err(Problem::NotFinite)));
    }
}
