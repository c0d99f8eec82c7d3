//! Bytes to mono PCM at the rates the features need; limits are enforced while decoding.

mod decode;
mod downmix;
mod error;
#[doc(hidden)]
pub mod fuzzing;
mod gapless;
mod kernel;
mod limits;
mod mp4;
mod outputs;
mod resample;
mod sniff;
mod source;

pub use error::AudioError;
pub use resample::{Resampler, resample};
pub use sniff::Container;

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    time::Duration,
};

use bailando_core::CancelToken;
use decode::Job;
use limits::Watch;
use source::Packets;

/// What an upload may ask of the decoder (RELIABILITY: decode on a bounded pool).
#[derive(Clone, Debug, PartialEq)]
pub struct AudioLimits {
    /// Longest decoded duration in seconds, checked packet by packet: from the file's start to the
    /// end of the range.
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
/// The container is told from the bytes. Outside the used range the signals are zero, as at the
/// ends of a file; encoder delay and padding are taken off; damaged packets become silence. Beyond
/// the outputs (`4 * duration * rate` bytes per rate) nothing grows with the length of the audio:
/// there is one packet, some seconds on the way to the resamplers, and one filter table per rate
/// (usually 0.7 MiB, at most 4 MiB; the last 8 are kept for later calls).
///
/// `max_seconds` counts from the start of the file to the end of the range, because what lies in
/// front of the range is decoded as well; what lies behind it is never decoded and not counted.
///
/// # Errors
/// Any [`AudioError`]: unknown container, undecodable, outside `limits` or the range, cancelled. A
/// panic of the decoder is an error of this call alone.
pub fn decode(
    bytes: bytes::Bytes,
    range: AudioRange,
    rates: &[u32],
    limits: &AudioLimits,
    cancel: &CancelToken,
) -> Result<DecodedAudio, AudioError> {
    contained(move || {
        let watch = Watch::start(limits, cancel);
        watch.check()?;
        range.check()?;
        if let Some(&hz) = rates.iter().find(|&&hz| hz == 0) {
            return Err(AudioError::OutputRate { hz });
        }
        let upload = sniff::sniff(&bytes)?;
        drop(bytes);
        limits::check_declared(&upload, range, limits)?;
        limits::check_packets(Packets::open(&upload)?, range, limits, &watch)?;
        let job = Job {
            range,
            rates,
            limits,
            watch: &watch,
        };
        decode::decode_packets(Packets::open(&upload)?, &upload, &job)
    })
}

/// Turns a panic inside `work` into an error (RELIABILITY, defence 5). Everything that `work`
/// touches is dropped by the unwinding, so nothing half-changed is seen afterwards.
fn contained<T>(work: impl FnOnce() -> Result<T, AudioError>) -> Result<T, AudioError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| {
        let message = payload
            .downcast_ref::<&str>()
            .map(|text| (*text).to_owned())
            .or_else(|| payload.downcast_ref::<String>().cloned())
            .unwrap_or_else(|| "no message".to_owned());
        Err(AudioError::DecoderPanic { message })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_of_this_call_alone() {
        let broken: Result<(), _> = contained(|| panic!("index {} out of bounds", 3));
        assert!(matches!(
            broken,
            Err(AudioError::DecoderPanic { message }) if message == "index 3 out of bounds"
        ));
        assert!(matches!(contained(|| Ok(7)), Ok(7)));
    }
}
