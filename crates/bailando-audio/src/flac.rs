//! The parts of FLAC files that symphonia keeps to itself (RFC 9639).

use bytes::Bytes;
use symphonia::core::{packet::Packet, units::Timestamp};

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
