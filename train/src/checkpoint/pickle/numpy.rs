//! NumPy's arrays and numbers inside a pickle, rebuilt from their bytes.

use std::sync::Arc;

use super::{
    array::{Dtype, Number, NumpyArray, NumpyName, Raw},
    value::{Arena, Id, Object},
};

/// More dimensions than any motion has.
const MAX_DIMENSIONS: usize = 8;

/// Returns what a call of `name` makes.
pub(super) fn call(arena: &Arena, name: NumpyName, arguments: Id) -> Result<Object, &'static str> {
    let arguments = arena.items(arguments).ok_or("arguments are no tuple")?;
    match (name, arguments) {
        (NumpyName::Reconstruct, _) => Ok(Object::EmptyArray),
        (NumpyName::Dtype, &[code, ..]) => dtype(arena, code).map(Object::Dtype),
        (NumpyName::Scalar, &[dtype, raw]) => array(arena, Vec::new(), dtype, raw, false),
        (NumpyName::FromBuffer, &[raw, dtype, shape, order]) => {
            let fortran = arena.text(order).is_some_and(|order| &**order == "F");
            array(arena, sizes(arena, shape)?, dtype, raw, fortran)
        }
        (NumpyName::Encode, &[text, encoding]) => {
            let encoding = arena.text(encoding).map(|name| &**name);
            match (arena.text(text), encoding) {
                (Some(text), Some("latin1" | "latin-1")) => {
                    Ok(Object::Raw(Raw::Latin1(Arc::clone(text))))
                }
                _ => Err("bytes are spelled in another encoding than latin1"),
            }
        }
        _ => Err("a function of NumPy is called with other arguments than NumPy writes"),
    }
}

/// Returns the array that BUILD makes of `(version, shape, dtype, is_fortran, bytes)`.
pub(super) fn filled_array(arena: &Arena, state: Id) -> Result<Object, &'static str> {
    match arena.items(state) {
        Some(&[_, shape, dtype, fortran, raw]) => {
            let fortran = arena.get(fortran) == Some(&Object::Bool(true));
            array(arena, sizes(arena, shape)?, dtype, raw, fortran)
        }
        _ => Err("an array's state is not what NumPy writes"),
    }
}

/// Returns the type that BUILD makes of `(version, byte order, ..)`.
pub(super) fn ordered_dtype(
    arena: &Arena,
    dtype: Dtype,
    state: Id,
) -> Result<Object, &'static str> {
    let order = match arena.items(state) {
        Some(&[_, order, ..]) => arena.text(order).map(|order| &**order),
        _ => None,
    };
    let big_endian = match order {
        Some("<" | "|" | "=") => false,
        Some(">") => true,
        _ => return Err("an array's byte order is unknown"),
    };
    Ok(Object::Dtype(Dtype { big_endian, ..dtype }))
}

fn dtype(arena: &Arena, code: Id) -> Result<Dtype, &'static str> {
    let code = arena.text(code).ok_or("an array's type has no name")?;
    let (big_endian, code) = match code.strip_prefix('>') {
        Some(code) => (true, code),
        None => (false, code.trim_start_matches(['<', '=', '|'])),
    };
    let number = match code {
        "f4" => Number::F32,
        "f8" => Number::F64,
        "i4" => Number::I32,
        "i8" => Number::I64,
        _ => return Err("an array holds something else than f4, f8, i4 or i8 numbers"),
    };
    Ok(Dtype { number, big_endian })
}

fn array(
    arena: &Arena,
    shape: Vec<usize>,
    dtype: Id,
    raw: Id,
    fortran: bool,
) -> Result<Object, &'static str> {
    match (arena.get(dtype), arena.get(raw)) {
        (Some(&Object::Dtype(dtype)), Some(Object::Raw(raw))) => {
            Ok(Object::Array(Box::new(NumpyArray { shape, dtype, fortran, raw: raw.clone() })))
        }
        _ => Err("an array lacks its type or its bytes"),
    }
}

fn sizes(arena: &Arena, id: Id) -> Result<Vec<usize>, &'static str> {
    let unfit = "an array's shape is no short list of sizes";
    let items = arena.items(id).ok_or(unfit)?;
    if items.len() > MAX_DIMENSIONS {
        return Err(unfit);
    }
    items.iter().map(|&item| arena.size(item).ok_or(unfit)).collect()
}
