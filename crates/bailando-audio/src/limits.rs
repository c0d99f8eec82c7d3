//! Limits that are held while decoding (RELIABILITY, defence 4): what headers declare is checked
//! first, what packets say next, and what was really decoded always.

use std::time::Instant;

use super::{
    AudioError, AudioLimits, AudioRange,
    sniff::{Container, Upload},
    source::Packets,
};
use bailando_core::CancelToken;

/// Encoder delay, padding and rounding that a count of packets may hold beyond the audio itself.
pub(super) const SLACK_S: f64 = 1.0;

/// The caller's patience: the cancel token and the wall deadline.
#[derive(Debug)]
pub(super) struct Watch<'job> {
    cancel: &'job CancelToken,
    started: Instant,
    limits: &'job AudioLimits,
}

impl<'job> Watch<'job> {
    /// Starts the clock.
    pub(super) fn start(limits: &'job AudioLimits, cancel: &'job CancelToken) -> Self {
        Self {
            cancel,
            started: Instant::now(),
            limits,
        }
    }

    /// Called for every packet.
    pub(super) fn check(&self) -> Result<(), AudioError> {
        if self.cancel.is_cancelled() {
            return Err(AudioError::Cancelled);
        }
        if self.started.elapsed() > self.limits.max_decode_time {
            return Err(AudioError::DecodeTimeout {
                limit: self.limits.max_decode_time,
            });
        }
        Ok(())
    }
}

impl AudioLimits {
    /// Refuses a sample rate or a number of channels outside the limits.
    pub(super) fn check_format(&self, hz: u32, channels: usize) -> Result<(), AudioError> {
        if !(self.min_sample_rate..=self.max_sample_rate).contains(&hz) {
            return Err(AudioError::SampleRate {
                hz,
                min_hz: self.min_sample_rate,
                max_hz: self.max_sample_rate,
            });
        }
        if channels == 0 || channels > self.max_channels {
            return Err(AudioError::Channels {
                count: channels,
                max: self.max_channels,
            });
        }
        Ok(())
    }

    /// Refuses `seconds` of audio from the file's start.
    pub(super) fn check_length(&self, seconds: f64) -> Result<(), AudioError> {
        if seconds > self.max_seconds {
            return Err(AudioError::TooLong {
                seconds,
                max_seconds: self.max_seconds,
            });
        }
        Ok(())
    }
}

impl AudioRange {
    /// End of the wanted part in seconds from the file's start; infinite without a duration.
    pub(super) fn end_s(&self) -> f64 {
        self.duration_s
            .map_or(f64::INFINITY, |duration| self.offset_s + duration)
    }

    /// Refuses a range that is none.
    pub(super) fn check(&self) -> Result<(), AudioError> {
        let offset_fits = self.offset_s.is_finite() && self.offset_s >= 0.0;
        let duration_fits = self
            .duration_s
            .is_none_or(|duration| duration.is_finite() && duration > 0.0);
        if offset_fits && duration_fits {
            return Ok(());
        }
        Err(AudioError::InvalidRange {
            offset_s: self.offset_s,
            duration_s: self.duration_s,
        })
    }
}

/// Reads WAV's and FLAC's fixed headers and refuses what they declare outside the limits, before
/// any decoder sees it: symphonia refuses some of it too, but without naming the value.
pub(super) fn check_declared(
    upload: &Upload,
    range: AudioRange,
    limits: &AudioLimits,
) -> Result<(), AudioError> {
    match upload.container {
        Container::Wav => match wav_format(&upload.bytes) {
            Some((channels, hz)) => limits.check_format(hz, channels),
            None => Ok(()),
        },
        Container::Flac => {
            let Some((hz, channels, frames)) = flac_stream_info(&upload.bytes) else {
                return Ok(());
            };
            limits.check_format(hz, channels)?;
            limits.check_length((frames as f64 / f64::from(hz)).min(range.end_s()))
        }
        _ => Ok(()),
    }
}

/// Channels and sample rate of a WAV file's `fmt ` chunk.
fn wav_format(bytes: &[u8]) -> Option<(usize, u32)> {
    const CHUNKS_LOOKED_AT: usize = 64;
    let mut at = 12_usize;
    for _ in 0..CHUNKS_LOOKED_AT {
        let size = u32_le(bytes, at.checked_add(4)?)?;
        let body = at.checked_add(8)?;
        if bytes.get(at..at + 4)? == b"fmt " {
            let channels = u16::from_le_bytes(*bytes.get(body + 2..)?.first_chunk()?);
            return Some((usize::from(channels), u32_le(bytes, body + 4)?));
        }
        // Chunks start at even positions.
        at = body.checked_add((size as usize).checked_next_multiple_of(2)?)?;
    }
    None
}

/// Sample rate, channels and declared frames (0: unknown) of a FLAC file.
fn flac_stream_info(bytes: &[u8]) -> Option<(u32, usize, u64)> {
    const MARKER_AND_HEADER: usize = 8;
    const STREAM_INFO: u8 = 0;
    if bytes.get(4)? & 0x7f != STREAM_INFO {
        return None;
    }
    // 20 bits rate, 3 bits channels - 1, 5 bits depth - 1, 36 bits frames.
    let packed = bytes.get(MARKER_AND_HEADER + 10..)?.first_chunk()?;
    let packed = u64::from_be_bytes(*packed);
    let channels = usize::from((packed >> 41) as u8 & 7) + 1;
    Some(((packed >> 44) as u32, channels, packed & 0xf_ffff_ffff))
}

fn u32_le(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

/// Adds up what the packets say they last, without decoding any. A file of hours of silence is a
/// few hundred kilobytes of packets, but gigabytes of samples: it is refused here in milliseconds.
/// What the packets say is not believed further than that; decoding keeps its own count.
pub(super) fn check_packets(
    mut packets: Packets,
    range: AudioRange,
    limits: &AudioLimits,
    watch: &Watch<'_>,
) -> Result<(), AudioError> {
    let mut seconds = 0.0;
    while let Some(packet) = packets.next(watch)? {
        seconds += packets.track.seconds(&packet);
        limits.check_length(seconds.min(range.end_s()) - SLACK_S)?;
        if seconds - SLACK_S > range.end_s() {
            return Ok(());
        }
    }
    if seconds > 0.0 && range.offset_s > seconds {
        return Err(AudioError::RangeOutside {
            offset_s: range.offset_s,
            length_s: seconds,
        });
    }
    Ok(())
}
