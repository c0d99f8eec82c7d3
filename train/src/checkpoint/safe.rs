//! The safetensors container: sizes, types and places as JSON, then the values, dense.

use std::{collections::HashMap, ops::Range, sync::Arc};

use safetensors::{Dtype, SafeTensors};

use super::{
    error::Problem,
    names::{Views, plain},
    pickle::{ElementType, Storage, TensorView},
};
use crate::host_tensor::elements;

/// Bytes before the header that give its length.
const LENGTH_BYTES: usize = 8;

/// An opened safetensors file.
#[derive(Debug)]
pub(super) struct SafeFile {
    bytes: Vec<u8>,
    values: HashMap<Arc<str>, Range<usize>>,
}

impl SafeFile {
    /// Whether bytes begin as safetensors do: a length that fits, and an object of JSON.
    pub(super) fn is_this(bytes: &[u8]) -> bool {
        let Some((length, rest)) = bytes.split_first_chunk::<LENGTH_BYTES>() else {
            return false;
        };
        rest.first() == Some(&b'{') && u64::from_le_bytes(*length) <= rest.len() as u64
    }

    pub(super) fn open(bytes: Vec<u8>) -> Result<(Self, Views), Problem> {
        // Compares places and sizes with each other and with the bytes that are there.
        let (header, metadata) = SafeTensors::read_metadata(&bytes)
            .map_err(|error| Problem::Safetensors(error.to_string()))?;
        let start = LENGTH_BYTES + header;
        let mut values = HashMap::new();
        let mut views = Vec::new();
        for (name, info) in metadata.tensors() {
            let key: Arc<str> = name.into();
            let (from, to) = info.data_offsets;
            values.insert(Arc::clone(&key), start + from..start + to);
            let element =
                element(info.dtype).ok_or_else(|| Problem::Dtype(format!("{:?}", info.dtype)))?;
            views.push((Arc::clone(&key), view(key, element, &info.shape)));
        }
        let views = plain(views.iter().map(|(name, view)| (&**name, view.clone())))?;
        Ok((Self { bytes, values }, views))
    }

    pub(super) fn storage(&self, key: &str) -> Result<&[u8], Problem> {
        let range = self.values.get(key).cloned();
        let found = range.and_then(|range| self.bytes.get(range));
        found.ok_or_else(|| Problem::MissingEntry(key.to_owned()))
    }
}

/// A dense tensor, whose storage is its own.
fn view(key: Arc<str>, element: ElementType, shape: &[usize]) -> TensorView {
    let mut strides = vec![1; shape.len()];
    let mut stride = 1_usize;
    for (place, &size) in strides.iter_mut().zip(shape).rev() {
        *place = stride;
        stride = stride.saturating_mul(size);
    }
    let values = elements(shape).unwrap_or(usize::MAX);
    let storage = Storage { key, element, values };
    TensorView { storage, offset: 0, shape: shape.to_vec(), strides }
}

fn element(dtype: Dtype) -> Option<ElementType> {
    Some(match dtype {
        Dtype::F64 => ElementType::F64,
        Dtype::F32 => ElementType::F32,
        Dtype::F16 => ElementType::F16,
        Dtype::BF16 => ElementType::Bf16,
        Dtype::I64 => ElementType::I64,
        Dtype::I32 => ElementType::I32,
        Dtype::I16 => ElementType::I16,
        Dtype::I8 => ElementType::I8,
        Dtype::U8 => ElementType::U8,
        Dtype::BOOL => ElementType::Bool,
        _ => return None,
    })
}
