//! What a caller may ask for.

use std::{
    cmp::Ordering,
    num::{NonZeroU32, NonZeroUsize},
};

use serde::Serialize;
use utoipa::ToSchema;

use super::{ByteSize, Seconds};
use crate::{audio::AudioLimits, engine::DEFAULT_BATCH, server::form};

/// Memory that a second of audio takes, all stages together; measured (`tests/load/uploads.py`).
const BYTES_PER_SECOND: f64 = 700_000.0;

/// Every limit of the service, as `GET /info` reports it.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema, clap::Args)]
pub struct Limits {
    /// Requests that are worked on at the same time
    #[arg(
        long,
        env = "BAILANDO_MAX_CONCURRENT_REQUESTS",
        default_value_t = Limits::default().max_concurrent_requests
    )]
    #[schema(value_type = u64)]
    pub max_concurrent_requests: NonZeroUsize,
    /// Requests that may wait for their turn; one more is answered 429 with Retry-After
    #[arg(long, env = "BAILANDO_QUEUE", default_value_t = Limits::default().queue)]
    pub queue: usize,
    /// Dances that share a step of the model, each candidate counted; so much of its memory is taken
    #[arg(long, env = "BAILANDO_BATCH", default_value_t = Limits::default().batch)]
    #[schema(value_type = u64)]
    pub batch: NonZeroUsize,
    /// Requests whose bodies may be on their way at the same time; one more is answered 429
    #[arg(
        long,
        env = "BAILANDO_MAX_UPLOADS",
        default_value_t = Limits::default().max_uploads
    )]
    #[schema(value_type = u64)]
    pub max_uploads: NonZeroUsize,
    /// Bytes of uploads that are held at the same time, until they are decoded; what goes beyond is answered 429
    #[arg(
        long,
        env = "BAILANDO_UPLOAD_MEMORY",
        default_value_t = Limits::default().upload_memory
    )]
    #[serde(rename = "upload_memory_bytes")]
    #[schema(value_type = u64)]
    pub upload_memory: ByteSize,
    /// Bytes of answers that are held for their readers at the same time; who goes beyond waits
    #[arg(
        long,
        env = "BAILANDO_ANSWER_MEMORY",
        default_value_t = Limits::default().answer_memory
    )]
    #[serde(rename = "answer_memory_bytes")]
    #[schema(value_type = u64)]
    pub answer_memory: ByteSize,
    /// Seconds of audio that are worked on at the same time; who goes beyond waits
    #[arg(
        long,
        env = "BAILANDO_AUDIO_SECONDS_IN_FLIGHT",
        default_value_t = Limits::default().audio_seconds_in_flight,
        value_parser = above_zero
    )]
    pub audio_seconds_in_flight: f64,
    /// Jobs that are kept at the same time, finished ones included; one more takes the place of one whose
    /// result was fetched, or else is answered 429
    #[arg(
        long,
        env = "BAILANDO_MAX_JOBS",
        default_value_t = Limits::default().max_jobs
    )]
    #[schema(value_type = u64)]
    pub max_jobs: NonZeroUsize,
    /// Time in seconds that a finished job is kept
    #[arg(
        long,
        env = "BAILANDO_JOB_TTL",
        default_value_t = Limits::default().job_ttl
    )]
    #[serde(rename = "job_ttl_s")]
    #[schema(value_type = f64)]
    pub job_ttl: Seconds,
    /// Requests a minute that each client may make of the routes that work, on average; clients are told
    /// apart by their API key, else by the address that connects: behind a proxy all without a key are one
    /// client [default: no limit]
    #[arg(long, env = "BAILANDO_RATE_LIMIT")]
    #[serde(rename = "rate_limit_per_minute")]
    #[schema(value_type = Option<u32>)]
    pub rate_limit: Option<NonZeroU32>,
    /// Requests that a client may make at once, where there is a rate limit
    #[arg(
        long,
        env = "BAILANDO_RATE_BURST",
        default_value_t = Limits::default().rate_burst
    )]
    #[schema(value_type = u32)]
    pub rate_burst: NonZeroU32,
    /// Connections at the same time; further ones wait to be accepted
    #[arg(
        long,
        env = "BAILANDO_MAX_CONNECTIONS",
        default_value_t = Limits::default().max_connections
    )]
    #[schema(value_type = u64)]
    pub max_connections: NonZeroUsize,
    /// Requests at the same time on one HTTP/2 connection
    #[arg(
        long,
        env = "BAILANDO_MAX_HTTP2_STREAMS",
        default_value_t = Limits::default().max_http2_streams
    )]
    #[schema(value_type = u32)]
    pub max_http2_streams: NonZeroU32,
    /// Longest time in seconds that sending a request's head may take, and that a connection may be idle
    #[arg(
        long,
        env = "BAILANDO_HEADER_READ_TIMEOUT",
        default_value_t = Limits::default().header_read_timeout
    )]
    #[serde(rename = "header_read_timeout_s")]
    #[schema(value_type = f64)]
    pub header_read_timeout: Seconds,
    /// Longest time in seconds that a client may take nothing of its answer
    #[arg(
        long,
        env = "BAILANDO_ANSWER_IDLE_TIMEOUT",
        default_value_t = Limits::default().answer_idle_timeout
    )]
    #[serde(rename = "answer_idle_timeout_s")]
    #[schema(value_type = f64)]
    pub answer_idle_timeout: Seconds,
    /// Largest audio file; bytes, or with kB, MB, KiB, MiB
    #[arg(
        long,
        env = "BAILANDO_PAYLOAD_LIMIT",
        default_value_t = Limits::default().payload_limit
    )]
    #[serde(rename = "payload_limit_bytes")]
    #[schema(value_type = u64)]
    pub payload_limit: ByteSize,
    /// Largest wav or flac file (told from its first bytes)
    #[arg(
        long,
        env = "BAILANDO_PAYLOAD_LIMIT_LOSSLESS",
        default_value_t = Limits::default().payload_limit_lossless
    )]
    #[serde(rename = "payload_limit_lossless_bytes")]
    #[schema(value_type = u64)]
    pub payload_limit_lossless: ByteSize,
    /// Shortest audio in seconds
    #[arg(
        long,
        env = "BAILANDO_MIN_AUDIO_SECONDS",
        default_value_t = Limits::default().min_audio_seconds,
        value_parser = zero_or_more
    )]
    pub min_audio_seconds: f64,
    /// Longest audio in seconds, counted while decoding
    #[arg(
        long,
        env = "BAILANDO_MAX_AUDIO_SECONDS",
        default_value_t = Limits::default().max_audio_seconds,
        value_parser = above_zero
    )]
    pub max_audio_seconds: f64,
    /// Lowest sample rate of an upload in Hz
    #[arg(
        long,
        env = "BAILANDO_MIN_SAMPLE_RATE",
        default_value_t = Limits::default().min_sample_rate,
        value_parser = clap::value_parser!(u32).range(1..)
    )]
    #[serde(rename = "min_sample_rate_hz")]
    pub min_sample_rate: u32,
    /// Highest sample rate of an upload in Hz
    #[arg(
        long,
        env = "BAILANDO_MAX_SAMPLE_RATE",
        default_value_t = Limits::default().max_sample_rate,
        value_parser = clap::value_parser!(u32).range(1..)
    )]
    #[serde(rename = "max_sample_rate_hz")]
    pub max_sample_rate: u32,
    /// Most channels of an upload
    #[arg(
        long,
        env = "BAILANDO_MAX_CHANNELS",
        default_value_t = Limits::default().max_channels,
        value_parser = at_least_one
    )]
    pub max_channels: usize,
    /// Longest time in seconds that decoding one upload may take
    #[arg(
        long,
        env = "BAILANDO_DECODE_TIMEOUT",
        default_value_t = Limits::default().decode_timeout
    )]
    #[serde(rename = "decode_timeout_s")]
    #[schema(value_type = f64)]
    pub decode_timeout: Seconds,
    /// Longest silence in seconds while a body is sent
    #[arg(
        long,
        env = "BAILANDO_BODY_IDLE_TIMEOUT",
        default_value_t = Limits::default().body_idle_timeout
    )]
    #[serde(rename = "body_idle_timeout_s")]
    #[schema(value_type = f64)]
    pub body_idle_timeout: Seconds,
    /// Longest time in seconds that sending a whole body may take
    #[arg(
        long,
        env = "BAILANDO_BODY_TIMEOUT",
        default_value_t = Limits::default().body_timeout
    )]
    #[serde(rename = "body_timeout_s")]
    #[schema(value_type = f64)]
    pub body_timeout: Seconds,
    /// Longest time in seconds from a request's head to its answer, waiting included
    #[arg(
        long,
        env = "BAILANDO_REQUEST_TIMEOUT",
        default_value_t = Limits::default().request_timeout
    )]
    #[serde(rename = "request_timeout_s")]
    #[schema(value_type = f64)]
    pub request_timeout: Seconds,
    /// Time in seconds that accepted requests have left once the server is told to stop
    #[arg(
        long,
        env = "BAILANDO_SHUTDOWN_TIMEOUT",
        default_value_t = Limits::default().shutdown_timeout
    )]
    #[serde(rename = "shutdown_timeout_s")]
    #[schema(value_type = f64)]
    pub shutdown_timeout: Seconds,
}

impl Default for Limits {
    fn default() -> Self {
        let audio = AudioLimits::default();
        Self {
            max_concurrent_requests: NonZeroUsize::MIN.saturating_add(3),
            queue: 32,
            batch: DEFAULT_BATCH,
            max_uploads: NonZeroUsize::MIN.saturating_add(255),
            upload_memory: ByteSize(400_000_000),
            answer_memory: ByteSize(400_000_000),
            audio_seconds_in_flight: 2400.0,
            max_jobs: NonZeroUsize::MIN.saturating_add(15),
            job_ttl: Seconds::new(600),
            rate_limit: None,
            rate_burst: NonZeroU32::MIN.saturating_add(9),
            max_connections: NonZeroUsize::MIN.saturating_add(1023),
            max_http2_streams: NonZeroU32::MIN.saturating_add(31),
            header_read_timeout: Seconds::new(10),
            answer_idle_timeout: Seconds::new(30),
            payload_limit: ByteSize(25_000_000),
            payload_limit_lossless: ByteSize(100_000_000),
            min_audio_seconds: audio.min_seconds,
            max_audio_seconds: audio.max_seconds,
            min_sample_rate: audio.min_sample_rate,
            max_sample_rate: audio.max_sample_rate,
            max_channels: audio.max_channels,
            decode_timeout: Seconds(audio.max_decode_time),
            body_idle_timeout: Seconds::new(10),
            body_timeout: Seconds::new(60),
            request_timeout: Seconds::new(120),
            shutdown_timeout: Seconds::new(30),
        }
    }
}

/// Limits that contradict each other.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LimitsError {
    /// No audio is long enough and short enough, or a bound is not a number.
    #[error("--min-audio-seconds {min} must not be above --max-audio-seconds {max}")]
    AudioSeconds {
        /// Shortest audio.
        min: f64,
        /// Longest audio.
        max: f64,
    },
    /// No sample rate is high enough and low enough.
    #[error("--min-sample-rate {min} must not be above --max-sample-rate {max}")]
    SampleRate {
        /// Lowest rate in Hz.
        min: u32,
        /// Highest rate in Hz.
        max: u32,
    },
    /// The largest file would never find room.
    #[error("--upload-memory {memory} is less than the largest file in a form, {body}")]
    UploadMemory {
        /// Room for all uploads.
        memory: ByteSize,
        /// The largest file, with what a form has around it.
        body: ByteSize,
    },
    /// The longest song would never have its turn.
    #[error("--audio-seconds-in-flight {in_flight} is less than --max-audio-seconds {longest}")]
    AudioInFlight {
        /// Room for all songs.
        in_flight: f64,
        /// The longest song.
        longest: f64,
    },
}

impl Limits {
    /// Checks that the bounds of every range are in order.
    ///
    /// # Errors
    /// [`LimitsError`] names the first two that are not.
    pub fn check(&self) -> Result<(), LimitsError> {
        let (min, max) = (self.min_audio_seconds, self.max_audio_seconds);
        // A bound that is not a number is in no order.
        if min.partial_cmp(&max).is_none_or(Ordering::is_gt) {
            return Err(LimitsError::AudioSeconds { min, max });
        }
        let (min, max) = (self.min_sample_rate, self.max_sample_rate);
        if min > max {
            return Err(LimitsError::SampleRate { min, max });
        }
        let body = self.largest_body();
        if self.upload_memory < body {
            return Err(LimitsError::UploadMemory {
                memory: self.upload_memory,
                body,
            });
        }
        let (in_flight, longest) = (self.audio_seconds_in_flight, self.max_audio_seconds);
        if in_flight < longest {
            return Err(LimitsError::AudioInFlight { in_flight, longest });
        }
        Ok(())
    }

    /// The largest file of any kind.
    pub(crate) fn largest_file(&self) -> ByteSize {
        self.payload_limit.max(self.payload_limit_lossless)
    }

    /// The largest file, and what a form has around it.
    pub(crate) fn largest_body(&self) -> ByteSize {
        ByteSize(self.largest_file().0.saturating_add(form::OVERHEAD))
    }

    /// Most bytes that one request takes while it is worked on: its upload, and for every second of audio the
    /// signals, features, motion and answer.
    #[must_use]
    pub fn memory_per_request(&self) -> u64 {
        let upload = self.largest_file().0;
        upload.saturating_add((self.max_audio_seconds * BYTES_PER_SECOND) as u64)
    }

    /// The part of the limits that the decoder enforces.
    #[must_use]
    pub fn audio(&self) -> AudioLimits {
        AudioLimits {
            max_seconds: self.max_audio_seconds,
            min_seconds: self.min_audio_seconds,
            min_sample_rate: self.min_sample_rate,
            max_sample_rate: self.max_sample_rate,
            max_channels: self.max_channels,
            max_decode_time: self.decode_timeout.0,
        }
    }
}

fn above_zero(text: &str) -> Result<f64, String> {
    number(text, |value| value > 0.0).ok_or_else(|| "give a number above 0".to_owned())
}

fn zero_or_more(text: &str) -> Result<f64, String> {
    number(text, |value| value >= 0.0).ok_or_else(|| "give a number, 0 or more".to_owned())
}

fn number(text: &str, fits: impl FnOnce(f64) -> bool) -> Option<f64> {
    let value = text.trim().parse::<f64>().ok()?;
    (value.is_finite() && fits(value)).then_some(value)
}

fn at_least_one(text: &str) -> Result<usize, String> {
    match text.trim().parse() {
        Ok(count) if count > 0 => Ok(count),
        _ => Err("give a whole number above 0".to_owned()),
    }
}
