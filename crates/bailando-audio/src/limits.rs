//! The caller's conditions: limits, the part of the song, and a deadline.

use std::time::{Duration, Instant};

use bailando_core::CancelToken;

use crate::error::AudioError;

/// Encoder delay, padding and rounding that a count of packets may hold beyond the audio itself.
pub(crate) const SLACK_S: f64 = 1.0;

/// Limits of one upload (RELIABILITY, defence 4).
#[derive(Clone, Debug, PartialEq)]
pub struct AudioLimits {
    /// Longest duration in seconds, checked packet by packet: from the start of the file to the
    /// end of the range.
    pub max_seconds: f64,
    /// Shortest duration in seconds.
    pub min_seconds: f64,
    /// Lowest sample rate in Hz.
    pub min_sample_rate: u32,
    /// Highest sample rate in Hz.
    pub max_sample_rate: u32,
    /// Most channels.
    pub max_channels: usize,
    /// Longest wall time that decoding one upload may take.
    pub max_decode_time: Duration,
}

impl Default for AudioLimits {
    fn default() -> Self {
        Self {
            max_seconds: 600.0,
            min_seconds: 0.5,
            min_sample_rate: 8_000,
            max_sample_rate: 192_000,
            max_channels: 8,
            max_decode_time: Duration::from_secs(30),
        }
    }
}

impl AudioLimits {
    /// Refuses a sample rate or a number of channels outside the limits.
    pub(crate) fn check_format(&self, hz: u32, channels: usize) -> Result<(), AudioError> {
        if !(self.min_sample_rate..=self.max_sample_rate).contains(&hz) {
            return Err(AudioError::SampleRate {
                hz,
                min_hz: self.min_sample_rate,
                max_hz: self.max_sample_rate,
            });
        }
        if channels == 0 || channels > self.max_channels {
            return Err(AudioError::Channels { count: channels, max: self.max_channels });
        }
        Ok(())
    }

    /// Refuses `seconds` of audio from the start of the file.
    pub(crate) fn check_length(&self, seconds: f64) -> Result<(), AudioError> {
        if seconds > self.max_seconds {
            return Err(AudioError::TooLong { seconds, max_seconds: self.max_seconds });
        }
        Ok(())
    }
}

/// The part of a song to use, in seconds from its start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AudioRange {
    /// Start in seconds.
    pub offset_s: f64,
    /// Length in seconds; absent: to the end.
    pub duration_s: Option<f64>,
}

impl AudioRange {
    /// Returns the end of the part in seconds from the start of the file; infinite without a
    /// duration.
    pub(crate) fn end_s(&self) -> f64 {
        self.duration_s.map_or(f64::INFINITY, |duration| self.offset_s + duration)
    }

    /// Refuses an impossible part.
    pub(crate) fn check(&self) -> Result<(), AudioError> {
        let offset_fits = self.offset_s.is_finite() && self.offset_s >= 0.0;
        let duration_fits =
            self.duration_s.is_none_or(|duration| duration.is_finite() && duration > 0.0);
        if offset_fits && duration_fits {
            return Ok(());
        }
        Err(AudioError::InvalidRange { offset_s: self.offset_s, duration_s: self.duration_s })
    }
}

/// The end of the caller's patience: the cancel token or the wall time.
#[derive(Debug)]
pub(crate) struct Deadline<'a> {
    cancel: &'a CancelToken,
    started: Instant,
    limit: Duration,
}

impl<'a> Deadline<'a> {
    /// Starts the clock.
    pub(crate) fn start(limit: Duration, cancel: &'a CancelToken) -> Self {
        Self { cancel, started: Instant::now(), limit }
    }

    /// Fails once the caller has given up or the time is over. Called for every packet.
    pub(crate) fn check(&self) -> Result<(), AudioError> {
        if self.cancel.is_cancelled() {
            return Err(AudioError::Cancelled);
        }
        if self.started.elapsed() > self.limit {
            return Err(AudioError::DecodeTimeout { limit: self.limit });
        }
        Ok(())
    }
}

/// One call of the decoder.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DecodeRequest<'a> {
    pub(crate) range: AudioRange,
    /// Sample rates of the outputs in Hz.
    pub(crate) rates: &'a [u32],
    pub(crate) limits: &'a AudioLimits,
    pub(crate) deadline: &'a Deadline<'a>,
}

impl DecodeRequest<'_> {
    /// Refuses a file of which `seconds` are known, as far as the range needs them.
    pub(crate) fn check_length(&self, seconds: f64) -> Result<(), AudioError> {
        self.limits.check_length(seconds.min(self.range.end_s()))
    }
}
