//! Bounded reading of a pickle's operands.

use std::sync::Arc;

use super::Object;
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
        Problem::Pickle { offset: self.offset, what }
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
        self.text_of(b'X')
    }

    /// The operand of any opcode that carries a text.
    pub(super) fn text_of(&mut self, opcode: u8) -> Result<Arc<str>, Problem> {
        let bytes = self.bytes_of(opcode)?;
        match std::str::from_utf8(bytes) {
            Ok(text) => Ok(text.into()),
            Err(_) => Err(self.malformed("a text is not UTF-8")),
        }
    }

    /// The operand of any opcode that carries bytes behind their number, which is one byte, four or
    /// eight wide.
    pub(super) fn bytes_of(&mut self, opcode: u8) -> Result<&'a [u8], Problem> {
        let length = match opcode {
            b'C' | 0x8c => u64::from(self.byte()?),
            b'B' | b'X' => u64::from(u32::from_le_bytes(self.array()?)),
            _ => u64::from_le_bytes(self.array()?),
        };
        let length = usize::try_from(length).map_err(|_| Problem::Truncated(self.offset))?;
        self.take(length)
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

    /// GLOBAL's operand: module and name.
    pub(super) fn global(&mut self) -> Result<(&'a [u8], &'a [u8]), Problem> {
        Ok((self.line()?, self.line()?))
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
