//! What the names of modules and classes in a pickle stand for: never looked up, never imported.

use super::{ElementType, Object, array::NumpyName};
use crate::checkpoint::error::Problem;

/// Longest name that an error repeats.
const MAX_SHOWN: usize = 80;

/// In a checkpoint unknown names are inert.
pub(super) fn of_checkpoint(module: &[u8], name: &[u8]) -> Object {
    match (module, name) {
        (b"collections", b"OrderedDict") => Object::OrderedDictClass,
        (b"torch._utils", b"_rebuild_tensor_v2") => Object::RebuildTensor,
        (b"torch._utils", b"_rebuild_parameter") => Object::RebuildParameter,
        (b"torch", name) => std::str::from_utf8(name)
            .ok()
            .and_then(ElementType::of_class)
            .map_or(Object::OtherClass, Object::StorageClass),
        _ => Object::OtherClass,
    }
}

/// Beside arrays there is no use for any other name.
pub(super) fn of_arrays(module: &[u8], name: &[u8]) -> Result<Object, Problem> {
    // NumPy 2 renamed `core` to `_core`.
    let name = match (module, name) {
        (b"numpy.core.multiarray" | b"numpy._core.multiarray", b"_reconstruct") => {
            NumpyName::Reconstruct
        }
        (b"numpy.core.multiarray" | b"numpy._core.multiarray", b"scalar") => NumpyName::Scalar,
        (b"numpy.core.numeric" | b"numpy._core.numeric", b"_frombuffer") => NumpyName::FromBuffer,
        (b"numpy", b"ndarray") => NumpyName::Ndarray,
        (b"numpy", b"dtype") => NumpyName::Dtype,
        (b"_codecs", b"encode") => NumpyName::Encode,
        (b"collections", b"OrderedDict") => return Ok(Object::OrderedDictClass),
        _ => {
            let mut shown = String::from_utf8_lossy(&[module, b".", name].concat()).into_owned();
            if let Some((end, _)) = shown.char_indices().nth(MAX_SHOWN) {
                shown.truncate(end);
            }
            return Err(Problem::Global(shown.escape_default().to_string()));
        }
    };
    Ok(Object::Numpy(name))
}
