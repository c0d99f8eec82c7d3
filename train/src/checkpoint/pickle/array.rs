//! NumPy's arrays as a pickle holds them.

use std::{borrow::Cow, sync::Arc};

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
pub(super) enum Number {
    F32,
    F64,
    I32,
    I64,
}

/// Type of an array's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Dtype {
    pub(super) number: Number,
    pub(super) big_endian: bool,
}

/// An array or a number of NumPy: shape, type and bytes, not checked against each other yet.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NumpyArray {
    pub(crate) shape: Vec<usize>,
    pub(super) dtype: Dtype,
    pub(super) fortran: bool,
    pub(super) raw: Raw,
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
        let expected =
            self.shape.iter().try_fold(width, |product: usize, &size| product.checked_mul(size));
        if expected != Some(bytes.len()) {
            return Err("an array's shape does not fit its bytes");
        }
        Ok(bytes.chunks_exact(width).map(|chunk| self.dtype.value(chunk)).collect())
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
