//! EBML (RFC 8794), as far as Matroska's audio needs it. Elements that hold others are entered, all
//! others are one unit; so a size that is not known, which only the former may have, needs no care.

pub(crate) const CLUSTER: u32 = 0x1f43_b675;
pub(crate) const TRACK_ENTRY: u32 = 0xae;
pub(crate) const TRACK_NUMBER: u32 = 0xd7;
pub(crate) const TRACK_TYPE: u32 = 0x83;
pub(crate) const CODEC_ID: u32 = 0x86;
pub(crate) const CODEC_PRIVATE: u32 = 0x63a2;
pub(crate) const CODEC_DELAY: u32 = 0x56aa;
pub(crate) const SAMPLING_FREQUENCY: u32 = 0xb5;
pub(crate) const CHANNELS: u32 = 0x9f;
pub(crate) const BIT_DEPTH: u32 = 0x6264;
pub(crate) const CONTENT_ENCODINGS: u32 = 0x6d80;
pub(crate) const SIMPLE_BLOCK: u32 = 0xa3;
pub(crate) const BLOCK: u32 = 0xa1;
pub(crate) const DISCARD_PADDING: u32 = 0x75a2;
const SEGMENT: u32 = 0x1853_8067;
const TRACKS: u32 = 0x1654_ae6b;
const AUDIO: u32 = 0xe1;
const BLOCK_GROUP: u32 = 0xa0;

/// First bytes of a file.
pub(crate) const MARK: &[u8] = b"\x1aE\xdf\xa3";

/// Head of an element.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Element {
    pub(crate) id: u32,
    start: usize,
    /// End of the content; none where the size is not known.
    end: Option<usize>,
}

impl Element {
    /// Reads the element at `at`; `None` at the end and where there is none.
    pub(crate) fn read(file: &[u8], at: usize) -> Option<Self> {
        let first = *file.get(at)?;
        let length = first.leading_zeros() as usize + 1;
        if length > 4 {
            return None;
        }
        let id = file.get(at..at + length)?;
        let id = id.iter().fold(0, |id, &byte| (id << 8) | u32::from(byte));
        let (size, size_length) = vint(file, at + length)?;
        let start = at + length + size_length;
        let unknown = size == (1 << (7 * size_length)) - 1;
        let end = usize::try_from(size).ok().and_then(|size| start.checked_add(size));
        let element = Self { id, start, end: end.filter(|_| !unknown) };
        (element.is_entered() || element.end.is_some()).then_some(element)
    }

    fn is_entered(&self) -> bool {
        matches!(self.id, SEGMENT | CLUSTER | TRACKS | TRACK_ENTRY | AUDIO | BLOCK_GROUP)
    }

    /// Returns where the next element starts: the first child, or what follows.
    pub(crate) fn next(&self) -> usize {
        if self.is_entered() { self.start } else { self.end.unwrap_or(self.start) }
    }

    /// Returns the whole content.
    pub(crate) fn body<'a>(&self, file: &'a [u8]) -> Option<&'a [u8]> {
        file.get(self.start..self.end?)
    }
}

/// Returns a number of variable length at `at`, and its length.
pub(crate) fn vint(bytes: &[u8], at: usize) -> Option<(u64, usize)> {
    let first = *bytes.get(at)?;
    let length = first.leading_zeros() as usize + 1;
    let rest = bytes.get(at..at.checked_add(length)?).filter(|_| length <= 8)?;
    let value = rest.iter().fold(0, |value, &byte| (value << 8) | u64::from(byte));
    Some((value & ((1 << (7 * length)) - 1), length))
}

/// Returns an unsigned number of up to 8 bytes.
pub(crate) fn unsigned(body: &[u8]) -> u64 {
    body.iter().take(8).fold(0, |value, &byte| (value << 8) | u64::from(byte))
}

/// Returns a signed number of up to 8 bytes.
pub(crate) fn signed(body: &[u8]) -> i64 {
    let unused = 64 - 8 * body.len().clamp(1, 8);
    (unsigned(body) << unused).cast_signed() >> unused
}

/// Returns a float of 4 or 8 bytes, 0 for any other.
pub(crate) fn float(body: &[u8]) -> f64 {
    match *body {
        [a, b, c, d] => f64::from(f32::from_be_bytes([a, b, c, d])),
        [a, b, c, d, e, f, g, h] => f64::from_be_bytes([a, b, c, d, e, f, g, h]),
        _ => 0.0,
    }
}

/// Returns the frames of a block (RFC 9559 section 10.3); `None` for sizes beyond the block.
pub(crate) fn unlace(block: &[u8]) -> Option<Vec<&[u8]>> {
    let (_, number) = vint(block, 0)?;
    let flags = *block.get(number + 2)?;
    let mut rest = block.get(number + 3..)?;
    let lacing = (flags >> 1) & 3;
    if lacing == 0 {
        return Some(vec![rest]);
    }
    let count = usize::from(*rest.first()?) + 1;
    rest = &rest[1..];
    let mut sizes = Vec::with_capacity(count);
    match lacing {
        1 => {
            for _ in 1..count {
                sizes.push(laced_size(&mut rest)?);
            }
        }
        2 => sizes.resize(count - 1, rest.len() / count),
        _ => {
            let mut size = 0_i64;
            for index in 1..count {
                let (value, length) = vint(rest, 0)?;
                rest = &rest[length..];
                let middle = (1_i64 << (7 * length - 1)) - 1;
                let value = i64::try_from(value).ok()?;
                size = if index == 1 { value } else { size.checked_add(value - middle)? };
                sizes.push(usize::try_from(size).ok()?);
            }
        }
    }
    let mut frames = Vec::with_capacity(count);
    for size in sizes {
        let (frame, after) = rest.split_at_checked(size)?;
        frames.push(frame);
        rest = after;
    }
    frames.push(rest);
    Some(frames)
}

/// Returns the three headers of Vorbis in a track's private data (Xiph lacing).
pub(crate) fn laced_headers(private: &[u8]) -> Option<Vec<&[u8]>> {
    let mut rest = private.strip_prefix(&[2])?;
    let (first, second) = (laced_size(&mut rest)?, laced_size(&mut rest)?);
    let (identification, rest) = rest.split_at_checked(first)?;
    let (comment, setup) = rest.split_at_checked(second)?;
    Some(vec![identification, comment, setup])
}

/// Takes a size: bytes of 255 and the first other one, added up.
fn laced_size(rest: &mut &[u8]) -> Option<usize> {
    let full = rest.iter().position(|&byte| byte != 255)?;
    let size = 255 * full + usize::from(rest[full]);
    *rest = &rest[full + 1..];
    Some(size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_lacings_give_their_frames() {
        let block = |flags: u8, rest: &[u8]| [&[0x81, 0, 0, flags], rest].concat();
        assert_eq!(unlace(&block(0, b"abc")), Some(vec![b"abc".as_slice()]));
        let wanted: Vec<&[u8]> = vec![b"a", b"bcd", b"ef"];
        assert_eq!(unlace(&block(2, b"\x02\x01\x03abcdef")), Some(wanted.clone()));
        // EBML lacing: the first size, then signed differences of one byte (middle 63).
        assert_eq!(unlace(&block(6, b"\x02\x81\xc1abcdef")), Some(wanted));
        let equal: Vec<&[u8]> = vec![b"ab", b"cd"];
        assert_eq!(unlace(&block(4, b"\x01abcd")), Some(equal));
        assert_eq!(unlace(&block(2, b"\x02\x09\x03abcdef")), None);
    }

    #[test]
    fn numbers_are_read_with_their_sign() {
        assert_eq!(vint(&[0x40, 0x7f], 0), Some((127, 2)));
        assert_eq!(signed(&[0xff, 0xfe]), -2);
        assert_eq!(signed(&[0x7f]), 127);
        assert_eq!(float(&48_000_f32.to_be_bytes()), 48_000.0);
    }
}
