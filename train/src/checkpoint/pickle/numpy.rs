//! NumPy's arrays and numbers inside a pickle, rebuilt from their bytes.

use std::{borrow::Cow, sync::Arc};

use super::{Arena, Id, Object};

/// More dimensions than any motion has.
const MAX_DIMENSIONS: usize = 8;

/// The functions and classes that pickled arrays name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NumpyName {
    /// `multiarray._reconstruct(ndarray, (0,), b'b')`: an empty array that BUILD fills.
    Reconstruct,
    /// `multiarray.scalar(dtype, bytes)`.
    Scalar,
    /// `numeric._frombuffer(bytes, dtype, shape, order)`, protocol 5.
    FromBuffer,
    Ndarray,
    Dtype,
    /// `_codecs.encode(text, 'latin1')`: how protocol 2 writes bytes.
    Encode,
}

/// Bytes of the pickle. Protocol 2 spells them as text; that is undone only when values are read,
/// so that naming one text many times costs nothing.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Raw {
    Bytes(Arc<[u8]>),
    Latin1(Arc<str>),
}

impl Raw {
    fn bytes(&self) -> Result<Cow<'_, [u8]>, &'static str> {
        match self {
            Self::Bytes(bytes) => Ok(Cow::Borrowed(bytes)),
            Self::Latin1(text) => {
                let bytes: Result<Vec<u8>, _> = text.chars().map(u8::try_from).collect();
                let bytes = bytes.map_err(|_| "bytes spelled as text leave Latin-1")?;
                Ok(Cow::Owned(bytes))
            }
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Number {
    F32,
    F64,
    I32,
    I64,
}

/// Type of an array's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Dtype {
    number: Number,
    big_endian: bool,
}

/// An array or a number of NumPy: shape, type and bytes, not checked against each other yet.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NumpyArray {
    pub(crate) shape: Vec<usize>,
    dtype: Dtype,
    fortran: bool,
    raw: Raw,
}

impl NumpyArray {
    /// The values in C order.
    pub(crate) fn values(&self) -> Result<Vec<f64>, &'static str> {
        if self.fortran && self.shape.iter().filter(|&&size| size != 1).count() > 1 {
            return Err("an array is stored column by column");
        }
        let bytes = self.raw.bytes()?;
        let width = match self.dtype.number {
            Number::F32 | Number::I32 => 4,
            Number::F64 | Number::I64 => 8,
        };
        let expected = self
            .shape
            .iter()
            .try_fold(width, |product: usize, &size| product.checked_mul(size));
        if expected != Some(bytes.len()) {
            return Err("an array's shape does not fit its bytes");
        }
        Ok(bytes
            .chunks_exact(width)
            .map(|chunk| self.dtype.value(chunk))
            .collect())
    }
}

impl Dtype {
    fn value(self, chunk: &[u8]) -> f64 {
        let mut wide = [0_u8; 8];
        for (to, from) in wide.iter_mut().zip(chunk) {
            *to = *from;
        }
        let used = chunk.len().min(wide.len());
        if let (true, Some(used)) = (self.big_endian, wide.get_mut(..used)) {
            used.reverse();
        }
        let bits = u64::from_le_bytes(wide);
        // The casts to 32 bits drop what `wide` is padded with.
        match self.number {
            Number::F32 => f64::from(f32::from_bits(bits as u32)),
            Number::F64 => f64::from_bits(bits),
            Number::I32 => f64::from((bits as u32).cast_signed()),
            Number::I64 => bits.cast_signed() as f64,
        }
    }
}

/// What calling `name` would have made.
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

/// The array that BUILD makes of `(version, shape, dtype, is_fortran, bytes)`.
pub(super) fn filled_array(arena: &Arena, state: Id) -> Result<Object, &'static str> {
    match arena.items(state) {
        Some(&[_, shape, dtype, fortran, raw]) => {
            let fortran = arena.get(fortran) == Some(&Object::Bool(true));
            array(arena, sizes(arena, shape)?, dtype, raw, fortran)
        }
        _ => Err("an array's state is not what NumPy writes"),
    }
}

/// The type that BUILD makes of `(version, byte order, ..)`.
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
    Ok(Object::Dtype(Dtype {
        big_endian,
        ..dtype
    }))
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
            Ok(Object::Array(Box::new(NumpyArray {
                shape,
                dtype,
                fortran,
                raw: raw.clone(),
            })))
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
    items
        .iter()
        .map(|&item| arena.size(item).ok_or(unfit))
        .collect()
}
