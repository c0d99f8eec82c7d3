//! The binary container of glTF (GLB, glTF 2.0 section 4.4): chunks in, chunks out.

use std::ops::Range;

use super::refusal::problem;
use crate::error::FormatError;

const MAGIC: &[u8] = b"glTF";
const HEADER: usize = 12;
const CHUNK_HEADER: usize = 8;
const JSON: u32 = u32::from_le_bytes(*b"JSON");
const BIN: u32 = u32::from_le_bytes(*b"BIN\0");
/// Bytes to which chunks are aligned.
pub(super) const ALIGNMENT: usize = 4;

/// Where the chunks of a file are.
#[derive(Clone, Debug)]
pub(super) struct Chunks {
    pub(super) json: Range<usize>,
    pub(super) binary: Option<Range<usize>>,
    /// Everything after them.
    rest: Range<usize>,
}

/// Whether a file begins as GLB does.
pub(super) fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

/// Finds the chunks of a file.
pub(super) fn chunks(bytes: &[u8]) -> Result<Chunks, FormatError> {
    let number = |at: usize| {
        let four = bytes.get(at..at.checked_add(4)?)?;
        Some(u32::from_le_bytes(four.try_into().ok()?))
    };
    match number(4) {
        Some(2) => {}
        other => {
            let version = other.map_or("none".into(), |version| version.to_string());
            return problem(format!("its glTF version is {version}, not 2"));
        }
    }
    let length = number(8).unwrap_or_default() as usize;
    if length != bytes.len() {
        return problem(format!(
            "its header says that it has {length} bytes, and it has {}",
            bytes.len()
        ));
    }
    let chunk = |at: usize, kind: u32| {
        let start = at.checked_add(CHUNK_HEADER)?;
        let end = start.checked_add(number(at)? as usize)?;
        (number(at + 4)? == kind && end <= bytes.len()).then_some(start..end)
    };
    let Some(json) = chunk(HEADER, JSON) else {
        return problem("its first chunk is not JSON, or longer than the file");
    };
    let binary = chunk(json.end, BIN);
    let end = binary.as_ref().map_or(json.end, |binary| binary.end);
    if binary.is_none() && number(json.end + 4) == Some(BIN) {
        return problem("its BIN chunk is longer than the file");
    }
    Ok(Chunks { json, binary, rest: end..bytes.len() })
}

impl Chunks {
    /// Puts a file together of other JSON, a longer binary chunk and the rest of `bytes`.
    pub(super) fn with(
        &self,
        bytes: &[u8],
        json: &str,
        more: &[u8],
    ) -> Result<Vec<u8>, FormatError> {
        let binary = self.binary.clone().map_or(&[][..], |range| &bytes[range]);
        let rest = &bytes[self.rest.clone()];
        let json_length = json.len().next_multiple_of(ALIGNMENT);
        let start = binary.len().next_multiple_of(ALIGNMENT);
        let binary_length = (start + more.len()).next_multiple_of(ALIGNMENT);
        let length = HEADER + 2 * CHUNK_HEADER + json_length + binary_length + rest.len();
        let too_long = || FormatError::TooLong { format: "glb", bytes: length as u64 };
        let size = |length: usize| u32::try_from(length).map_err(|_| too_long());
        let mut file = Vec::with_capacity(length);
        file.extend(MAGIC);
        file.extend(2_u32.to_le_bytes());
        file.extend(size(length)?.to_le_bytes());
        file.extend(size(json_length)?.to_le_bytes());
        file.extend(JSON.to_le_bytes());
        file.extend(json.as_bytes());
        file.resize(HEADER + CHUNK_HEADER + json_length, b' ');
        file.extend(size(binary_length)?.to_le_bytes());
        file.extend(BIN.to_le_bytes());
        let begin = file.len();
        file.extend(binary);
        file.resize(begin + start, 0);
        file.extend(more);
        file.resize(begin + binary_length, 0);
        file.extend(rest);
        Ok(file)
    }
}
