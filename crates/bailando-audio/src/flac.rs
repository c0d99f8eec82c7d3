//! The parts of FLAC files that symphonia keeps to itself (RFC 9639).

use bytes::Bytes;
use symphonia::core::{packet::Packet, units::Timestamp};

use crate::{container::Container, rope, upload::Upload};

/// Returns a FLAC file as an upload. Some encoders leave the block sizes of the header at 0; the
/// frames themselves say whether all blocks have one size (section 9.1), which symphonia asks the
/// header.
pub(crate) fn repaired(file: Bytes) -> Upload {
    const SIZES: usize = 8;
    const SMALLEST: u16 = 16;
    let size = |at: usize| file.get(at..)?.first_chunk().map(|size| u16::from_be_bytes(*size));
    let mut upload = Upload::new(Container::Flac, file.clone());
    let (Some(least), Some(most)) = (size(SIZES), size(SIZES + 2)) else { return upload };
    if least >= SMALLEST && most >= SMALLEST {
        return upload;
    }
    let start = audio_start(&file).unwrap_or(file.len());
    let fixed = file.get(start + 1).is_some_and(|second| second & 1 == 0);
    let most = if most >= SMALLEST { most } else { block_size(&file, start).unwrap_or(u16::MAX) };
    let least = if fixed { most } else { SMALLEST };
    let sizes = [least.to_be_bytes(), most.to_be_bytes()].concat();
    upload.view = rope::repaired(&file, vec![(SIZES, sizes)]);
    upload
}

/// Returns the size of the block whose frame starts at `at`, where its code stands for one size
/// (section 9.1.1).
fn block_size(file: &[u8], at: usize) -> Option<u16> {
    match file.get(at + 2)? >> 4 {
        1 => Some(192),
        code @ 2..=5 => Some(576 << (code - 2)),
        code @ 8..=15 => Some(256 << (code - 8)),
        _ => None,
    }
}

/// Returns the samples of a frame from its header; 0 for what is no frame.
pub(crate) fn frame_samples(frame: &[u8]) -> u64 {
    const HEADER: usize = 4;
    if !is_frame(frame) {
        return 0;
    }
    // After the header come its position, in as many bytes as UTF-8 would take, and odd sizes.
    let position = frame.get(HEADER).map_or(1, |first| first.leading_ones().max(1));
    let at = HEADER + position as usize;
    let odd = match frame.get(2).map(|byte| byte >> 4) {
        Some(6) => frame.get(at).map(|&size| u64::from(size) + 1),
        Some(7) => {
            let size = frame.get(at..).and_then(|size| size.first_chunk());
            size.map(|size| u64::from(u16::from_be_bytes(*size)) + 1)
        }
        _ => block_size(frame, 0).map(u64::from),
    };
    odd.unwrap_or(0)
}

/// Whether a packet begins as a frame does, and not as a block of metadata.
pub(crate) fn is_frame(packet: &[u8]) -> bool {
    matches!(packet, [0xff, 0xf8 | 0xf9, ..])
}

/// Returns sample rate, channels and declared frames (0: unknown) of a FLAC file.
pub(crate) fn stream_info(bytes: &[u8]) -> Option<(u32, usize, u64)> {
    const MARKER_AND_HEADER: usize = 8;
    const STREAM_INFO: u8 = 0;
    if bytes.get(4)? & 0x7f != STREAM_INFO {
        return None;
    }
    // Section 8.2: 20 bits rate, 3 bits channels - 1, 5 bits depth - 1, 36 bits frames.
    let packed = bytes.get(MARKER_AND_HEADER + 10..)?.first_chunk()?;
    let packed = u64::from_be_bytes(*packed);
    let channels = usize::from((packed >> 41) as u8 & 7) + 1;
    Some(((packed >> 44) as u32, channels, packed & 0xf_ffff_ffff))
}

/// Returns the position of the first frame, after all metadata blocks.
fn audio_start(bytes: &[u8]) -> Option<usize> {
    const LAST_BLOCK: u8 = 0x80;
    let mut at = b"fLaC".len();
    loop {
        let [kind, a, b, c] = *bytes.get(at..)?.first_chunk()?;
        at += 4 + u32::from_be_bytes([0, a, b, c]) as usize;
        if kind & LAST_BLOCK != 0 {
            return Some(at);
        }
    }
}

/// Audio that is missing in front of a packet, in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Gap {
    /// Damage took this much.
    Lost(f64),
    /// The file is a part of a longer recording and starts this late in it.
    CutFrom(f64),
}

/// Finds lost frames. Symphonia's reader drops frames with a wrong checksum without a word, but
/// every frame carries its position (section 9.1.5).
#[derive(Debug)]
pub(crate) struct Gaps {
    /// Position that the next packet should have.
    expected: Timestamp,
    /// The audio from its first byte, until the first packet has come.
    audio: Option<Bytes>,
    /// Frames that the header declares.
    declared: Option<u64>,
    hz: u32,
}

impl Gaps {
    /// Prepares for the packets of `file`, whose header declares its frames and sample rate.
    pub(crate) fn new(file: &Bytes, declared: Option<u64>, hz: u32) -> Self {
        let start = audio_start(file).map_or(file.len(), |start| start.min(file.len()));
        Self {
            expected: Timestamp::ZERO,
            audio: Some(file.slice(start..)),
            declared,
            hz: hz.max(1),
        }
    }

    /// Prepares for packets whose times start at 0.
    pub(crate) fn from_zero(hz: u32) -> Self {
        Self { expected: Timestamp::ZERO, audio: None, declared: None, hz: hz.max(1) }
    }

    /// Returns what is missing between the packet before `packet` and itself.
    pub(crate) fn before(&mut self, packet: &Packet) -> Option<Gap> {
        let next = packet.pts.saturating_add(packet.dur);
        let expected = std::mem::replace(&mut self.expected, next);
        let audio = self.audio.take();
        let frames = packet.pts.duration_from(expected)?.get();
        if frames == 0 {
            return None;
        }
        let seconds = frames as f64 / f64::from(self.hz);
        // A recording that was cut in front begins with a whole frame. Where the position cannot
        // be true either, the gap is not believed.
        let cut = audio.is_some_and(|audio| {
            audio.starts_with(&packet.data) || self.declared.is_none_or(|all| frames > all)
        });
        Some(if cut { Gap::CutFrom(seconds) } else { Gap::Lost(seconds) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_tells_its_samples() {
        for (code, rest, expected) in [
            (0x19, &[0x18, 0, 0][..], 192),
            (0xc9, &[0x18, 0, 0][..], 4_096),
            (0x69, &[0x18, 0, 99][..], 100),
            (0x79, &[0x18, 0xc2, 0x80, 0x12, 0x33][..], 0x1234),
            (0x09, &[0x18, 0, 0][..], 0),
        ] {
            let frame = [&[0xff, 0xf8, code][..], rest].concat();
            assert_eq!(frame_samples(&frame), expected, "{code:x}");
        }
        assert_eq!(frame_samples(&[0xff, 0xf8]), 0);
        assert_eq!(frame_samples(b"\x84\0\0\x28 comment"), 0);
    }
}
