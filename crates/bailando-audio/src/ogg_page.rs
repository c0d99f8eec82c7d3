//! The pages of an Ogg file (RFC 3533 section 6).

/// First bytes of every page.
pub(crate) const MARK: &[u8] = b"OggS";

const HEADER: usize = 27;
const CHECKSUM: std::ops::Range<usize> = 22..26;

/// One page.
#[derive(Debug)]
pub(crate) struct Page<'a> {
    bytes: &'a [u8],
    flags: u8,
    /// Time stamp of the last packet that ends here, -1 without one.
    pub(crate) granule: i64,
    pub(crate) serial: u32,
    pub(crate) sequence: u32,
    pub(crate) segments: &'a [u8],
    pub(crate) body: &'a [u8],
    /// Where the next page starts.
    pub(crate) end: usize,
}

impl<'a> Page<'a> {
    /// Reads the page at `at`; `None` where there is none, or not the whole of it.
    pub(crate) fn read(file: &'a [u8], at: usize) -> Option<Self> {
        let rest = file.get(at..)?;
        let header: &[u8; HEADER] = rest.first_chunk()?;
        if !header.starts_with(MARK) || header[4] != 0 {
            return None;
        }
        let segments = rest.get(HEADER..HEADER + usize::from(header[26]))?;
        let body = HEADER + segments.len();
        let length: usize = segments.iter().map(|&size| usize::from(size)).sum();
        let bytes = rest.get(..body + length)?;
        let word = |from: usize| {
            let bytes = [header[from], header[from + 1], header[from + 2], header[from + 3]];
            u32::from_le_bytes(bytes)
        };
        Some(Self {
            bytes,
            flags: header[5],
            granule: (u64::from(word(6)) | (u64::from(word(10)) << 32)).cast_signed(),
            serial: word(14),
            sequence: word(18),
            segments,
            body: &bytes[body..],
            end: at + bytes.len(),
        })
    }

    pub(crate) fn is_continued(&self) -> bool {
        self.flags & 1 != 0
    }

    pub(crate) fn is_first(&self) -> bool {
        self.flags & 2 != 0
    }

    pub(crate) fn is_last(&self) -> bool {
        self.flags & 4 != 0
    }

    /// Returns whether the page's checksum is right.
    pub(crate) fn is_sound(&self) -> bool {
        let (before, after) = (&self.bytes[..CHECKSUM.start], &self.bytes[CHECKSUM.end..]);
        let sum = checksum(checksum(checksum(0, before), &[0; 4]), after);
        self.bytes[CHECKSUM] == sum.to_le_bytes()
    }
}

/// CRC-32 with the polynomial 0x04c11db7, unreflected.
fn checksum(start: u32, bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut index = 0;
        while index < 256 {
            let (mut value, mut bit) = ((index as u32) << 24, 0);
            while bit < 8 {
                value = (value << 1) ^ if value >> 31 == 1 { 0x04c1_1db7 } else { 0 };
                bit += 1;
            }
            table[index] = value;
            index += 1;
        }
        table
    };
    bytes.iter().fold(start, |sum, &byte| (sum << 8) ^ TABLE[usize::from((sum >> 24) as u8 ^ byte)])
}
