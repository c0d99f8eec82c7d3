//! MPEG audio layer III (ISO 11172-3 section 2.4.1.3): frame headers, and where a stream starts.

/// What a frame header says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    /// Bytes of the frame; 0 in free format, which does not say.
    pub(crate) length: usize,
    pub(crate) hz: u32,
    pub(crate) channels: usize,
    /// Samples of a channel.
    pub(crate) samples: u32,
    /// Bytes between the header and an information tag.
    pub(crate) side_info: usize,
    /// MPEG 1, 2 or 2.5, as the header codes it.
    version: u8,
}

impl Header {
    /// Reads the header that `bytes` start with.
    pub(crate) fn read(bytes: &[u8]) -> Option<Self> {
        const KBITS_V1: [usize; 14] =
            [32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320];
        const KBITS_V2: [usize; 14] = [8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160];
        let &[sync, version, rates, mode] = bytes.first_chunk()?;
        if sync != 0xff || version & 0xe0 != 0xe0 || (version >> 1) & 3 != 1 {
            return None;
        }
        let version = (version >> 3) & 3;
        let (rate_shift, kbits, slots) = match version {
            3 => (0, KBITS_V1, 144_000),
            2 => (1, KBITS_V2, 72_000),
            0 => (2, KBITS_V2, 72_000),
            _ => return None,
        };
        let hz = [44_100_u32, 48_000, 32_000].get(usize::from((rates >> 2) & 3))? >> rate_shift;
        // Index 0 is free format; 15 is forbidden.
        let length = match usize::from(rates >> 4).checked_sub(1) {
            None => 0,
            Some(index) => slots * kbits.get(index)? / hz as usize + usize::from((rates >> 1) & 1),
        };
        let channels = if mode >> 6 == 3 { 1 } else { 2 };
        let side_info = match (version, channels) {
            (3, 2) => 32,
            (3, _) | (_, 2) => 17,
            _ => 9,
        };
        let samples = if version == 3 { 1_152 } else { 576 };
        Some(Self { length, hz, channels, samples, side_info, version })
    }

    /// Returns whether both may be frames of one stream: only channels and bit rate may change.
    fn fits(&self, other: &Self) -> bool {
        self.version == other.version && self.hz == other.hz
    }
}

/// Frames in a row that make a stream certain.
const CERTAIN: usize = 4;

/// Returns whether `bytes` start with frames of one stream: [`CERTAIN`], or at least two up to
/// their end.
fn is_stream(bytes: &[u8]) -> bool {
    let Some(first) = Header::read(bytes).filter(|first| first.length > 0) else { return false };
    let mut at = first.length;
    for _ in 1..CERTAIN {
        match bytes.get(at..) {
            // The file ends with a frame, or inside one.
            None | Some([]) => return at > first.length,
            Some(rest) => match Header::read(rest) {
                Some(next) if next.length > 0 && first.fits(&next) => at += next.length,
                // What is left is too short for a header, or a tag.
                _ => return at > first.length && (rest.len() < 4 || rest.starts_with(b"TAG")),
            },
        }
    }
    true
}

/// Returns whether `bytes` are a stream from their first byte on, even one of a single frame.
pub(crate) fn starts_stream(bytes: &[u8]) -> bool {
    let sole = || {
        Header::read(bytes).is_some_and(|first| first.length > 0 && first.length + 4 > bytes.len())
    };
    is_stream(bytes) || sole()
}

/// Returns where an MPEG layer III stream starts within the first `reach` bytes.
pub(crate) fn find_stream(bytes: &[u8], reach: usize) -> Option<usize> {
    let window = &bytes[..reach.min(bytes.len())];
    (0..window.len()).find(|&at| window[at] == 0xff && is_stream(&bytes[at..]))
}

/// Returns whether `bytes` start with frames in free format: whose length nothing but the next
/// frame tells, always at the same distance.
pub(crate) fn is_free_format(bytes: &[u8]) -> bool {
    const LONGEST: usize = 8_192;
    let free = |at: usize| {
        let header = Header::read(bytes.get(at..)?)?;
        (header.length == 0).then_some(header)
    };
    let Some(first) = free(0) else { return false };
    let same = |at| free(at).is_some_and(|header| header.fits(&first));
    // A padded frame is a byte longer.
    let near = |at: usize| same(at) || same(at + 1);
    (24..LONGEST).any(|length| same(length) && near(2 * length) && near(3 * length))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn length(header: [u8; 4]) -> Option<usize> {
        Header::read(&header).map(|header| header.length)
    }

    #[test]
    fn frame_lengths_follow_the_standard() {
        assert_eq!(length([0xff, 0xfb, 0x90, 0]), Some(417));
        assert_eq!(length([0xff, 0xfb, 0x92, 0]), Some(418));
        // MPEG 2 at 24 kHz and 64 kbit/s: 72 * 64000 / 24000.
        assert_eq!(length([0xff, 0xf3, 0x84, 0]), Some(192));
        assert_eq!(length([0xff, 0xfb, 0x00, 0]), Some(0), "free format");
        assert_eq!(length([0xff, 0xfb, 0xf0, 0]), None);
    }

    #[test]
    fn sync_words_are_no_stream_without_frames_behind_them() {
        let art = [[0xff, 0xfb, 0x50, 0xc0].as_slice(), &[0; 252]].concat().repeat(100);
        assert_eq!(find_stream(&art, art.len()), None);
        let mut frame = vec![0xff, 0xfb, 0x90, 0x00];
        frame.resize(417, 0);
        let file = [art.as_slice(), &frame.repeat(5)].concat();
        assert_eq!(find_stream(&file, file.len()), Some(art.len()));
        assert_eq!(find_stream(&file, 1_000), None, "out of reach");
    }

    #[test]
    fn free_format_is_recognised_by_its_distance() {
        let mut frame = vec![0xff, 0xfb, 0x00, 0x00];
        frame.resize(700, 0x11);
        assert!(is_free_format(&frame.repeat(4)));
        assert!(!is_free_format(&frame));
    }
}
