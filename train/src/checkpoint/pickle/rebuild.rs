//! What the allowed globals mean: storages, tensors and parameters.

use super::{Arena, Id, Object, Storage, TensorView};

/// More dimensions than any weight has.
const MAX_DIMENSIONS: usize = 8;
/// Keys are decimal numbers; a bound keeps comparing them cheap.
const MAX_KEY_BYTES: usize = 64;

/// The storage behind a persistent id `("storage", class, key, location, values, [view])`.
pub(super) fn storage(arena: &Arena, id: Id) -> Result<Storage, &'static str> {
    let Some(&[tag, class, key, _location, values, ref view @ ..]) = arena.items(id) else {
        return Err("a persistent id is no storage");
    };
    if arena.text(tag).is_none_or(|tag| **tag != *"storage") {
        return Err("a persistent id is no storage");
    }
    // Views of storages were written by PyTorch before 0.4 alone.
    if !view.iter().all(|&view| arena.get(view) == Some(&Object::None)) {
        return Err("a storage is a view of another one");
    }
    let Some(&Object::StorageClass(element)) = arena.get(class) else {
        return Err("a storage is of an unknown class");
    };
    let key = arena.text(key).ok_or("a storage has no key")?;
    if key.len() > MAX_KEY_BYTES {
        return Err("a storage's key is too long");
    }
    let values = arena.size(values).ok_or("a storage has no size")?;
    Ok(Storage { key: key.clone(), element, values })
}

/// The tensor of `_rebuild_tensor_v2(storage, offset, shape, strides, requires_grad, hooks, ..)`.
pub(super) fn tensor(arena: &Arena, arguments: Id) -> Result<Box<TensorView>, &'static str> {
    let Some(&[storage, offset, shape, strides, ..]) = arena.items(arguments) else {
        return Err("a tensor lacks arguments");
    };
    let Some(Object::Storage(storage)) = arena.get(storage) else {
        return Err("a tensor has no storage");
    };
    let offset = arena.size(offset).ok_or("a tensor's offset is no size")?;
    let shape = sizes(arena, shape).ok_or("a tensor's shape is no list of sizes")?;
    let strides = sizes(arena, strides).ok_or("a tensor's strides are no list of sizes")?;
    if shape.len() != strides.len() {
        return Err("a tensor's shape and strides differ in length");
    }
    Ok(Box::new(TensorView { storage: storage.clone(), offset, shape, strides }))
}

/// The tensor inside `_rebuild_parameter(tensor, requires_grad, hooks)`.
pub(super) fn parameter(arena: &Arena, arguments: Id) -> Result<Object, &'static str> {
    match arena.items(arguments) {
        Some(&[tensor, ..]) => match arena.get(tensor) {
            Some(Object::Tensor(tensor)) => Ok(Object::Tensor(tensor.clone())),
            _ => Err("a parameter is no tensor"),
        },
        _ => Err("a parameter lacks arguments"),
    }
}

fn sizes(arena: &Arena, id: Id) -> Option<Vec<usize>> {
    let items = arena.items(id)?;
    if items.len() > MAX_DIMENSIONS {
        return None;
    }
    items.iter().map(|&item| arena.size(item)).collect()
}
