//! The error of this crate.

use std::{io, time::Duration};

use crate::container::{ACCEPTED, Container};

/// A fault of an upload. Messages say what was wrong and what is accepted.
#[derive(Debug, thiserror::Error)]
pub enum AudioError {
    /// The caller no longer wants the result.
    #[error("decoding was cancelled")]
    Cancelled,
    /// The body has no bytes.
    #[error("the audio is empty (0 bytes); accepted are {ACCEPTED}")]
    Empty,
    /// The bytes are not one of the accepted containers.
    #[error("this is not an accepted audio file: it looks like {found}; accepted are {ACCEPTED}")]
    UnsupportedContainer {
        /// Kind of the bytes, in words.
        found: &'static str,
    },
    /// The container is accepted, the codec inside it is not.
    #[error("the {container} file holds {codec}, which is not accepted; accepted are {ACCEPTED}")]
    UnsupportedCodec {
        /// The container the bytes are in.
        container: Container,
        /// Its content, in words.
        codec: String,
    },
    /// The container is accepted, but its content cannot be decoded.
    #[error("the {container} file is damaged and cannot be decoded: {reason}")]
    Malformed {
        /// The container the bytes are in.
        container: Container,
        /// The cause in words.
        reason: String,
    },
    /// Less audio than the shortest accepted.
    #[error(
        "the audio is {seconds:.3} s long; at least {min_seconds} s are needed (the setting \
         --min-audio-seconds)"
    )]
    TooShort {
        /// Seconds that were left to use, after the range was applied.
        seconds: f64,
        /// The limit in seconds.
        min_seconds: f64,
    },
    /// A part of the audio that was asked for is shorter than the shortest accepted.
    #[error("{reason}; at least {min_seconds} s are needed (the setting --min-audio-seconds)")]
    PartTooShort {
        /// The option that is to blame, and what it leaves of the audio.
        reason: String,
        /// The limit in seconds.
        min_seconds: f64,
    },
    /// More audio than the longest accepted.
    #[error(
        "the audio goes on after {max_seconds} s, the longest that is accepted (counted from the \
         start of the file to the end of the part used; the setting --max-audio-seconds)"
    )]
    TooLong {
        /// Seconds known when decoding was given up: a lower bound of the real length.
        seconds: f64,
        /// The limit in seconds.
        max_seconds: f64,
    },
    /// The sample rate is outside the limits.
    #[error("the sample rate is {hz} Hz; accepted are {min_hz} to {max_hz} Hz")]
    SampleRate {
        /// Sample rate of the upload in Hz.
        hz: u32,
        /// Lowest accepted rate in Hz.
        min_hz: u32,
        /// Highest accepted rate in Hz.
        max_hz: u32,
    },
    /// The number of channels is outside the limits.
    #[error("the audio has {count} channels; accepted are 1 to {max}")]
    Channels {
        /// Channels of the upload.
        count: usize,
        /// Most accepted.
        max: usize,
    },
    /// Decoding took longer than allowed.
    #[error("decoding took longer than the {:.1} s allowed for one upload", limit.as_secs_f64())]
    DecodeTimeout {
        /// The wall time allowed.
        limit: Duration,
    },
    /// The wanted part starts at or after the end of the audio.
    #[error("the offset of {offset_s} s lies outside the audio, which is {length_s:.3} s long")]
    RangeOutside {
        /// The wanted start in seconds.
        offset_s: f64,
        /// Length of the audio in seconds.
        length_s: f64,
    },
    /// The wanted part is not a possible one, whatever the audio.
    #[error(
        "the part from {offset_s} s for {} is not possible: \
         the offset must be 0 or more and the duration above 0 seconds",
        duration_s.map_or_else(|| "the rest".to_owned(), |seconds| format!("{seconds} s"))
    )]
    InvalidRange {
        /// The wanted start in seconds.
        offset_s: f64,
        /// The wanted length in seconds, if any.
        duration_s: Option<f64>,
    },
    /// A rate that cannot be resampled to was asked for (the caller's mistake, not the upload's).
    #[error("audio cannot be resampled to {hz} Hz")]
    OutputRate {
        /// The rate asked for.
        hz: u32,
    },
    /// The system did not start another thread for a resampler: the upload is not to blame.
    #[error("no thread could be started to resample the audio: {0}")]
    NoThread(#[source] io::Error),
    /// The decoder panicked; only this upload is affected.
    #[error("the audio made the decoder fail and cannot be used")]
    DecoderPanic {
        /// Text of the panic.
        message: String,
    },
}
