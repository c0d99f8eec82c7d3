//! The bytes of an upload as a reader of symphonia sees them: slices of the file in a row, with
//! short repairs between them. Nothing of the file is copied.

use std::io::{self, ErrorKind, Read, Seek, SeekFrom};

use bytes::Bytes;
use symphonia::core::io::MediaSource;

/// Slices in a row.
#[derive(Debug)]
pub(crate) struct Rope {
    /// Every slice with its position; none is empty.
    parts: Vec<(u64, Bytes)>,
    length: u64,
    position: u64,
    seekable: bool,
}

impl Rope {
    /// Joins `parts`.
    pub(crate) fn new(parts: Vec<Bytes>, seekable: bool) -> Self {
        let mut length = 0;
        let mut placed = Vec::with_capacity(parts.len());
        for part in parts.into_iter().filter(|part| !part.is_empty()) {
            let start = length;
            length += part.len() as u64;
            placed.push((start, part));
        }
        Self { parts: placed, length, position: 0, seekable }
    }
}

/// Returns `file` with the bytes at some positions replaced. The repairs are sorted by their
/// position here; one outside the file or within another is left out.
pub(crate) fn repaired(file: &Bytes, mut repairs: Vec<(usize, Vec<u8>)>) -> Vec<Bytes> {
    repairs.sort_by_key(|(at, _)| *at);
    let (mut parts, mut done) = (Vec::new(), 0);
    for (at, new) in repairs {
        let end = at.saturating_add(new.len());
        if at >= done && end <= file.len() {
            parts.extend([file.slice(done..at), Bytes::from(new)]);
            done = end;
        }
    }
    parts.push(file.slice(done..));
    parts
}

impl Read for Rope {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let after = self.parts.partition_point(|(start, _)| *start <= self.position);
        let Some((start, part)) = after.checked_sub(1).and_then(|last| self.parts.get(last)) else {
            return Ok(0);
        };
        let within = usize::try_from(self.position - start).unwrap_or(usize::MAX);
        let rest = part.get(within..).unwrap_or_default();
        let read = rest.len().min(buffer.len());
        buffer[..read].copy_from_slice(&rest[..read]);
        self.position += read as u64;
        Ok(read)
    }
}

impl Seek for Rope {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let to = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
            SeekFrom::Current(by) => self.position.checked_add_signed(by),
        };
        self.position = to.ok_or(ErrorKind::InvalidInput)?;
        Ok(self.position)
    }
}

impl MediaSource for Rope {
    fn is_seekable(&self) -> bool {
        self.seekable
    }

    fn byte_len(&self) -> Option<u64> {
        Some(self.length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repairs_replace_their_bytes_and_nothing_else() {
        let file = Bytes::from_static(b"0123456789");
        let repairs = vec![(7, b"XY".to_vec()), (0, b"ab".to_vec()), (1, vec![0]), (9, vec![0; 2])];
        let mut rope = Rope::new(repaired(&file, repairs), true);
        let mut all = String::new();
        rope.read_to_string(&mut all).unwrap();
        assert_eq!(all, "ab23456XY9");
        assert_eq!(rope.seek(SeekFrom::End(-4)).unwrap(), 6);
        let mut four = [0; 4];
        rope.read_exact(&mut four).unwrap();
        assert_eq!(&four, b"6XY9");
        rope.seek(SeekFrom::Start(99)).unwrap();
        assert_eq!(rope.read(&mut four).unwrap(), 0);
    }
}
