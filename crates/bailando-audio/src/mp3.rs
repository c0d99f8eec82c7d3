//! The frames of an MP3 file as packets. Every frame stands for itself, so that channels, sample
//! rate and bit rate may change; what is no frame is stepped over.

use bytes::Bytes;
use symphonia::core::{
    codecs::audio::{AudioCodecParameters, well_known::CODEC_ID_MP3},
    errors::Error as SymphoniaError,
    packet::Packet,
    units::{Duration, Timestamp},
};

use crate::{
    container::Container,
    error::AudioError,
    id3,
    mpeg::{self, Header},
    packets::{PacketReader, TrackInfo},
};

/// Reads frames.
#[derive(Debug)]
pub(crate) struct Mp3Reader {
    file: Bytes,
    at: usize,
    time: Timestamp,
}

impl Mp3Reader {
    /// Reads the first frame of `file`, which starts with one.
    pub(crate) fn open(file: &Bytes) -> Result<(Self, TrackInfo), AudioError> {
        let first = Header::read(file).ok_or_else(|| AudioError::Malformed {
            container: Container::Mp3,
            reason: "it has no frame".to_owned(),
        })?;
        let mut parameters = AudioCodecParameters::new();
        parameters.for_codec(CODEC_ID_MP3).with_sample_rate(first.hz);
        let mut track = TrackInfo::new(0, parameters, first.hz);
        let frame = &file[..first.length.min(file.len())];
        let mut at = 0;
        if let Some(tag) = Tag::read(frame, &first) {
            at = frame.len();
            if let Some(frames) = tag.frames.filter(|_| tag.is_possible(file.len())) {
                let (delay, padding) = tag.ends.unwrap_or_default();
                let all = u64::from(frames) * u64::from(first.samples);
                track.frames = Some(all.saturating_sub(u64::from(delay) + u64::from(padding)));
            }
            if let Some((delay, padding)) = tag.ends.filter(|_| tag.is_possible(file.len())) {
                (track.delay, track.padding) = (Some(delay), Some(padding));
            }
        } else if is_vbri(frame) {
            at = frame.len();
        }
        Ok((Self { file: file.clone(), at, time: Timestamp::ZERO }, track))
    }
}

impl PacketReader for Mp3Reader {
    fn next_packet(&mut self) -> Result<Option<Packet>, SymphoniaError> {
        loop {
            let rest = self.file.slice(self.at.min(self.file.len())..);
            let Some(header) = Header::read(&rest).filter(|header| header.length > 0) else {
                match self.after_damage(&rest)? {
                    true => continue,
                    false => return Ok(None),
                }
            };
            let Some(frame) = rest.get(..header.length) else {
                // The file ends inside a frame.
                self.at = self.file.len();
                return Ok(None);
            };
            self.at += header.length;
            // Where files were joined, the tag of the next one is no sound.
            if Tag::read(frame, &header).is_some() || is_vbri(frame) {
                continue;
            }
            let duration = Duration::from(header.samples);
            let packet = Packet::new(0, self.time, duration, frame);
            self.time = self.time.saturating_add(duration);
            return Ok(Some(packet));
        }
    }
}

impl Mp3Reader {
    /// Moves on to the next frames after bytes that are none. Returns whether there are some.
    fn after_damage(&mut self, rest: &[u8]) -> Result<bool, SymphoniaError> {
        let tag = id3::v2_end(rest);
        if tag > 0 && rest.get(tag..).is_some_and(|after| Header::read(after).is_some()) {
            self.at += tag;
            return Ok(true);
        }
        let Some(ahead) = rest.get(1..).and_then(|rest| mpeg::find_stream(rest, rest.len())) else {
            self.at = self.file.len();
            return Ok(false);
        };
        self.at += 1 + ahead;
        Err(SymphoniaError::DecodeError("mp3: bytes that are no frame"))
    }
}

/// The tag that encoders write into the first frame: `Xing` or `Info`, and LAME's part of it.
struct Tag {
    frames: Option<u32>,
    bytes: Option<u32>,
    /// Samples of lead-in and padding.
    ends: Option<(u32, u32)>,
}

impl Tag {
    fn read(frame: &[u8], header: &Header) -> Option<Self> {
        const CONTENTS: usize = 100;
        const QUALITY: usize = 4;
        let tag = frame.get(4 + header.side_info..)?;
        if !tag.starts_with(b"Xing") && !tag.starts_with(b"Info") {
            return None;
        }
        let flags = u32_be(tag, 4)?;
        let mut at = 8;
        let mut number = |flag: u32| {
            let value = (flags & flag != 0).then(|| u32_be(tag, at)).flatten();
            at += if flags & flag != 0 { 4 } else { 0 };
            value
        };
        let (frames, bytes) = (number(1), number(2));
        at += if flags & 4 != 0 { CONTENTS } else { 0 };
        at += if flags & 8 != 0 { QUALITY } else { 0 };
        Some(Self { frames, bytes, ends: tag.get(at..).and_then(lame) })
    }

    /// Returns whether a file of so many bytes can have so many frames.
    fn is_possible(&self, length: usize) -> bool {
        /// Shortest and longest frame: 8 kbit/s at 24 kHz; 320 kbit/s at 32 kHz with padding.
        const FRAME: std::ops::RangeInclusive<u64> = 24..=1_441;
        let Some(frames) = self.frames else { return true };
        // A file that was cut short has fewer bytes than the tag says, but not fewer a frame.
        let bytes = self.bytes.map_or(length as u64, u64::from);
        bytes.checked_div(u64::from(frames)).is_some_and(|size| FRAME.contains(&size))
    }
}

/// Returns lead-in and padding from LAME's part of the tag. The decoder adds 529 samples of its own
/// to the encoder's.
fn lame(part: &[u8]) -> Option<(u32, u32)> {
    const DECODER: u32 = 529;
    const ENDS: usize = 21;
    let known = [b"LAME", b"Lavf", b"Lavc"].iter().any(|name| part.starts_with(*name));
    let &[high, middle, low] = part.get(ENDS..)?.first_chunk()?;
    let ends = u32::from_be_bytes([0, high, middle, low]);
    known.then(|| ((ends >> 12) + DECODER, (ends & 0xfff).saturating_sub(DECODER)))
}

/// Returns whether a frame holds Fraunhofer's tag, which says nothing about lead-in and padding.
fn is_vbri(frame: &[u8]) -> bool {
    frame.get(36..40) == Some(b"VBRI")
}

fn u32_be(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}
