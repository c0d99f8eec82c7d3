//! Bounded reading of a pickle's operands.

use std::sync::Arc;

use super::{ElementType, Object};
use crate::checkpoint::error::Problem;

/// A cursor that never reads beyond its bytes and allocates no more than it has read.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    offset: usize,
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, offset: 0 }
    }

    pub(super) fn offset(&self) -> usize {
        self.offset
    }

    pub(super) fn malformed(&self, what: &'static str) -> Problem {
        Problem::Pickle {
            offset: self.offset,
            what,
        }
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], Problem> {
        let end = self.offset.checked_add(count);
        let taken = end.and_then(|end| self.bytes.get(self.offset..end));
        let taken = taken.ok_or(Problem::Truncated(self.offset))?;
        self.offset += count;
        Ok(taken)
    }

    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], Problem> {
        let offset = self.offset;
        let taken = self.take(N)?;
        taken.try_into().map_err(|_| Problem::Truncated(offset))
    }

    pub(super) fn byte(&mut self) -> Result<u8, Problem> {
        self.array::<1>().map(|[byte]| byte)
    }

    /// BINUNICODE's operand.
    pub(super) fn text(&mut self) -> Result<Arc<str>, Problem> {
        let length = u32::from_le_bytes(self.array()?);
        let length = usize::try_from(length).map_err(|_| Problem::Truncated(self.offset))?;
        let bytes = self.take(length)?;
        match std::str::from_utf8(bytes) {
            Ok(text) => Ok(text.into()),
            Err(_) => Err(self.malformed("a text is not UTF-8")),
        }
    }

    /// LONG1's operand: little-endian two's complement of any length.
    pub(super) fn long(&mut self) -> Result<Object, Problem> {
        let length = usize::from(self.byte()?);
        let bytes = self.take(length)?;
        if length > 8 {
            // Only the container's magic number is that long, and it is compared as bytes.
            return Ok(Object::Scalar);
        }
        let negative = bytes.last().is_some_and(|byte| byte & 0x80 != 0);
        let mut wide = if negative { [0xff; 8] } else { [0; 8] };
        for (to, from) in wide.iter_mut().zip(bytes) {
            *to = *from;
        }
        Ok(Object::Int(i64::from_le_bytes(wide)))
    }

    /// GLOBAL's operand, looked up in the list of known names.
    pub(super) fn global(&mut self) -> Result<Object, Problem> {
        let module = self.line()?;
        let name = self.line()?;
        Ok(match (module, name) {
            (b"collections", b"OrderedDict") => Object::OrderedDictClass,
            (b"torch._utils", b"_rebuild_tensor_v2") => Object::RebuildTensor,
            (b"torch._utils", b"_rebuild_parameter") => Object::RebuildParameter,
            (b"torch", name) => std::str::from_utf8(name)
                .ok()
                .and_then(ElementType::of_class)
                .map_or(Object::OtherClass, Object::StorageClass),
            _ => Object::OtherClass,
        })
    }

    fn line(&mut self) -> Result<&'a [u8], Problem> {
        let rest = self.bytes.get(self.offset..).unwrap_or_default();
        let end = rest.iter().position(|&byte| byte == b'\n');
        let end = end.ok_or(Problem::Truncated(self.bytes.len()))?;
        let line = self.take(end)?;
        self.take(1)?;
        Ok(line)
    }
}
