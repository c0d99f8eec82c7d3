//! Bounds of what callers may ask for.

use std::{
    cmp::Ordering,
    num::{NonZeroU32, NonZeroUsize},
};

use serde::Serialize;
use utoipa::ToSchema;

use super::units::{ByteSize, Seconds, at_least_one};
use crate::{
    audio::AudioLimits,
    engine::{DEFAULT_BATCH, DecodeEffort},
    formats::RigLimits,
};

/// Memory for one second of audio, all stages together; measured (`tests/load/uploads.py`).
const BYTES_PER_SECOND: f64 = 700_000.0;
/// Most bytes of a form beside its parts: boundaries and part headers. The parser never has to keep
/// more than that.
pub(crate) const FORM_OVERHEAD: u64 = 64 * 1024;

/// Defines all limits: description, name and type, name and type in JSON, environment variable,
/// default, and the parser where the type has none of its own. The name in JSON is a `tt`, since
/// utoipa does not see a `literal` that a macro passes on to `serde(rename)`.
macro_rules! limits {
    ($(
        $(#[doc = $about:literal])+
        $name:ident: $type:ty [$json:tt $($schema:tt)+]
            $env:literal $(= $default:expr)? $(, $parser:expr)?;
    )+) => {
        /// Every limit of the service, as `GET /info` reports it.
        #[derive(Clone, Debug, PartialEq, Serialize, ToSchema, clap::Args)]
        pub struct Limits {
            $(
                $(#[doc = $about])+
                #[arg(
                    long,
                    env = $env
                    $(, default_value_t = $default)?
                    $(, value_parser = $parser)?
                )]
                #[serde(rename = $json)]
                #[schema(value_type = $($schema)+)]
                pub $name: $type,
            )+
        }

        impl Default for Limits {
            fn default() -> Self {
                Self {
                    $($name: limits!(default $($default)?),)+
                }
            }
        }
    };
    (default) => { None };
    (default $value:expr) => { $value };
}

limits! {
    /// Share of every bounded resource that one client may hold: workers, places in the queue,
    /// jobs, uploads, memory for uploads and answers, connections; clients are distinguished as for
    /// --rate-limit. 1 for a single client or for all behind one proxy
    client_share: f64 ["client_share" f64] "BAILANDO_CLIENT_SHARE" = 0.75, fraction;
    /// Requests that are processed at the same time
    max_concurrent_requests: NonZeroUsize ["max_concurrent_requests" u64]
        "BAILANDO_MAX_CONCURRENT_REQUESTS" = count(4), whole;
    /// Seconds of dance, all candidates counted, up to which a request is short: of several
    /// workers, one is left to short requests
    short_seconds: f64 ["short_seconds" f64] "BAILANDO_SHORT_SECONDS" = 60.0, zero_or_more;
    /// Requests that may wait for a worker; one more is answered 429 with Retry-After
    queue: usize ["queue" usize] "BAILANDO_QUEUE" = 32;
    /// Sequences that share a step of the model, each candidate counted; memory is taken for all of
    /// them
    batch: NonZeroUsize ["batch" u64] "BAILANDO_BATCH" = DEFAULT_BATCH, whole;
    /// Requests whose bodies may be in transfer at the same time; one more is answered 429
    max_uploads: NonZeroUsize ["max_uploads" u64] "BAILANDO_MAX_UPLOADS" = count(256), whole;
    /// Bytes of uploads that are held at the same time, until they are decoded; above it, uploads
    /// are answered 429
    upload_memory: ByteSize ["upload_memory_bytes" u64]
        "BAILANDO_UPLOAD_MEMORY" = ByteSize(400_000_000);
    /// Bytes of responses that are held for their readers at the same time; further responses wait,
    /// or are answered 429 where their client leaves its share unread
    answer_memory: ByteSize ["answer_memory_bytes" u64]
        "BAILANDO_ANSWER_MEMORY" = ByteSize(400_000_000);
    /// Seconds of audio that are processed at the same time; further songs wait
    audio_seconds_in_flight: f64 ["audio_seconds_in_flight" f64]
        "BAILANDO_AUDIO_SECONDS_IN_FLIGHT" = 2400.0, above_zero;
    /// Jobs that are kept at the same time, finished ones included; one more replaces a job whose
    /// result was fetched, or else is answered 429
    max_jobs: NonZeroUsize ["max_jobs" u64] "BAILANDO_MAX_JOBS" = count(10_000), whole;
    /// Bytes of songs and results of jobs that are kept at the same time, without a data directory
    /// 400MB at most; a job that is not done counts with what its result is expected to take. Above
    /// it a new job replaces one whose result was fetched, or else is answered 503
    job_bytes: ByteSize ["job_bytes" u64] "BAILANDO_JOB_BYTES" = ByteSize(20_000_000_000);
    /// Longest time in seconds that a job may be worked on
    job_timeout: Seconds ["job_timeout_s" f64] "BAILANDO_JOB_TIMEOUT" = Seconds::new(600);
    /// Time in seconds that a finished job is kept, without a data directory 10 minutes at most
    job_ttl: Seconds ["job_ttl_s" f64] "BAILANDO_JOB_TTL" = Seconds::new(86_400);
    /// Time in seconds after which another worker takes a job whose worker no longer says that it
    /// lives
    job_lease: Seconds ["job_lease_s" f64] "BAILANDO_JOB_LEASE" = Seconds::new(15);
    /// Times that a job is tried when the service is at fault; what is wrong with a song or an
    /// option is tried once
    job_attempts: NonZeroUsize ["job_attempts" u64] "BAILANDO_JOB_ATTEMPTS" = count(3), whole;
    /// Times that a job is begun when its worker dies of it
    job_starts: NonZeroUsize ["job_starts" u64] "BAILANDO_JOB_STARTS" = count(10), whole;
    /// Requests a minute, on average, that each client may make of the routes that need a key;
    /// clients are distinguished by their API key, else by the address that connects: behind a
    /// proxy all clients without a key count as one [default: no limit]
    rate_limit: Option<NonZeroU32> ["rate_limit_per_minute" Option<u32>]
        "BAILANDO_RATE_LIMIT", whole_u32;
    /// Requests that a client may make at once, where there is a rate limit
    rate_burst: NonZeroU32 ["rate_burst" u32]
        "BAILANDO_RATE_BURST" = NonZeroU32::MIN.saturating_add(9), whole_u32;
    /// Connections at the same time; one more takes the place of the one that has been without a
    /// request for longest
    max_connections: NonZeroUsize ["max_connections" u64]
        "BAILANDO_MAX_CONNECTIONS" = count(1024), whole;
    /// Requests at the same time on one HTTP/2 connection
    max_http2_streams: NonZeroU32 ["max_http2_streams" u32]
        "BAILANDO_MAX_HTTP2_STREAMS" = NonZeroU32::MIN.saturating_add(31), whole_u32;
    /// Longest time in seconds that a connection is kept open without a request (keep-alive); the
    /// keep-alive of a proxy in front must be shorter
    connection_idle_timeout: Seconds ["connection_idle_timeout_s" f64]
        "BAILANDO_CONNECTION_IDLE_TIMEOUT" = Seconds::new(75);
    /// Longest time in seconds to send the head of a request, from its first byte on
    header_read_timeout: Seconds ["header_read_timeout_s" f64]
        "BAILANDO_HEADER_READ_TIMEOUT" = Seconds::new(10);
    /// Time in seconds in which a client must take its share of a response, as
    /// --answer-least-rate says; slower clients are cut off
    answer_idle_timeout: Seconds ["answer_idle_timeout_s" f64]
        "BAILANDO_ANSWER_IDLE_TIMEOUT" = Seconds::new(30);
    /// Bytes a second that a client must take of a response, on average over --answer-idle-timeout
    answer_least_rate: ByteSize ["answer_least_rate_bytes" u64]
        "BAILANDO_ANSWER_LEAST_RATE" = ByteSize(8_000);
    /// Largest audio file; bytes, or with kB, MB, KiB, MiB
    payload_limit: ByteSize ["payload_limit_bytes" u64]
        "BAILANDO_PAYLOAD_LIMIT" = ByteSize(25_000_000);
    /// Largest wav, aiff or flac file (recognised by its first bytes)
    payload_limit_lossless: ByteSize ["payload_limit_lossless_bytes" u64]
        "BAILANDO_PAYLOAD_LIMIT_LOSSLESS" = ByteSize(100_000_000);
    /// Largest character or skeleton of a caller's own (part rig: bvh, glb, vrm)
    rig_limit: ByteSize ["rig_limit_bytes" u64]
        "BAILANDO_RIG_LIMIT" = ByteSize(RigLimits::default().bytes as u64);
    /// Most bones or nodes of a caller's character
    rig_bones: usize ["rig_bones" usize]
        "BAILANDO_RIG_BONES" = RigLimits::default().bones, plain;
    /// Shortest audio in seconds
    min_audio_seconds: f64 ["min_audio_seconds" f64]
        "BAILANDO_MIN_AUDIO_SECONDS" = AudioLimits::default().min_seconds, zero_or_more;
    /// Longest audio in seconds, counted while decoding
    max_audio_seconds: f64 ["max_audio_seconds" f64]
        "BAILANDO_MAX_AUDIO_SECONDS" = AudioLimits::default().max_seconds, above_zero;
    /// Lowest sample rate of an upload in Hz
    min_sample_rate: u32 ["min_sample_rate_hz" u32] "BAILANDO_MIN_SAMPLE_RATE"
        = AudioLimits::default().min_sample_rate, clap::value_parser!(u32).range(1..);
    /// Highest sample rate of an upload in Hz
    max_sample_rate: u32 ["max_sample_rate_hz" u32] "BAILANDO_MAX_SAMPLE_RATE"
        = AudioLimits::default().max_sample_rate, clap::value_parser!(u32).range(1..);
    /// Most channels of an upload
    max_channels: usize ["max_channels" usize]
        "BAILANDO_MAX_CHANNELS" = AudioLimits::default().max_channels, plain;
    /// Longest time in seconds to decode one upload
    decode_timeout: Seconds ["decode_timeout_s" f64]
        "BAILANDO_DECODE_TIMEOUT" = Seconds(AudioLimits::default().max_decode_time);
    /// Processor time in seconds that decoding may take for each megabyte of an upload, beside one
    /// second for any
    decode_cpu_per_megabyte: Seconds ["decode_cpu_per_megabyte_s" f64]
        "BAILANDO_DECODE_CPU_PER_MEGABYTE" = Seconds(DecodeEffort::default().per_megabyte);
    /// Processor time in seconds that decoding may take for each second of audio that is asked for
    decode_cpu_per_second: Seconds ["decode_cpu_per_second_s" f64]
        "BAILANDO_DECODE_CPU_PER_SECOND" = Seconds(DecodeEffort::default().per_second);
    /// Longest silence in seconds while a body is sent
    body_idle_timeout: Seconds ["body_idle_timeout_s" f64]
        "BAILANDO_BODY_IDLE_TIMEOUT" = Seconds::new(10);
    /// Bytes a second that a body must bring, on average over --body-idle-timeout
    body_least_rate: ByteSize ["body_least_rate_bytes" u64]
        "BAILANDO_BODY_LEAST_RATE" = ByteSize(1_000);
    /// Longest time in seconds to send a whole body
    body_timeout: Seconds ["body_timeout_s" f64] "BAILANDO_BODY_TIMEOUT" = Seconds::new(60);
    /// Longest time in seconds from the head of a request to its response, waiting included
    request_timeout: Seconds ["request_timeout_s" f64]
        "BAILANDO_REQUEST_TIMEOUT" = Seconds::new(120);
    /// Time in seconds for accepted requests to finish once the server is told to stop
    shutdown_timeout: Seconds ["shutdown_timeout_s" f64]
        "BAILANDO_SHUTDOWN_TIMEOUT" = Seconds::new(30);
}

const fn count(count: usize) -> NonZeroUsize {
    NonZeroUsize::MIN.saturating_add(count - 1)
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
    /// The largest file would never fit.
    #[error("--upload-memory {memory} is less than the largest song and rig in a form, {body}")]
    UploadMemory {
        /// Memory for all uploads.
        memory: ByteSize,
        /// The largest song and rig in a form.
        body: ByteSize,
    },
    /// The longest song would never be processed.
    #[error("--audio-seconds-in-flight {in_flight} is less than --max-audio-seconds {longest}")]
    AudioInFlight {
        /// Seconds of all songs together.
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
        // NaN compares with nothing.
        if min.partial_cmp(&max).is_none_or(Ordering::is_gt) {
            return Err(LimitsError::AudioSeconds { min, max });
        }
        let (min, max) = (self.min_sample_rate, self.max_sample_rate);
        if min > max {
            return Err(LimitsError::SampleRate { min, max });
        }
        let body = self.largest_body();
        if self.upload_memory < body {
            return Err(LimitsError::UploadMemory { memory: self.upload_memory, body });
        }
        let (in_flight, longest) = (self.audio_seconds_in_flight, self.max_audio_seconds);
        if in_flight < longest {
            return Err(LimitsError::AudioInFlight { in_flight, longest });
        }
        Ok(())
    }

    /// Returns how much of `all` one client may hold: one at least.
    pub(crate) fn share_of(&self, all: u64) -> u64 {
        ((all as f64 * self.client_share) as u64).clamp(1, all.max(1))
    }

    /// Returns the largest size of a file of any format.
    pub(crate) fn largest_file(&self) -> ByteSize {
        self.payload_limit.max(self.payload_limit_lossless)
    }

    /// Returns the largest size of a song and a character in a form.
    pub(crate) fn largest_body(&self) -> ByteSize {
        let files = self.largest_file().0.saturating_add(self.rig_limit.0);
        ByteSize(files.saturating_add(FORM_OVERHEAD))
    }

    /// Returns the most bytes of one request that is being processed: its upload, and for every
    /// second of audio the signals, features, motion and response.
    #[must_use]
    pub fn memory_per_request(&self) -> u64 {
        // A character exists as it was sent and as it is sent back.
        let upload = self.largest_file().0.saturating_add(self.rig_limit.0.saturating_mul(2));
        upload.saturating_add((self.max_audio_seconds * BYTES_PER_SECOND) as u64)
    }

    /// Returns the processor time that decoding may take.
    #[must_use]
    pub fn effort(&self) -> DecodeEffort {
        DecodeEffort {
            per_megabyte: self.decode_cpu_per_megabyte.0,
            per_second: self.decode_cpu_per_second.0,
            ..DecodeEffort::default()
        }
    }

    /// Returns the limits that the decoder enforces.
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

fn fraction(text: &str) -> Result<f64, String> {
    let fits = |value| value > 0.0 && value <= 1.0;
    number(text, fits).ok_or_else(|| "give a number above 0, up to 1".to_owned())
}

fn zero_or_more(text: &str) -> Result<f64, String> {
    number(text, |value| value >= 0.0).ok_or_else(|| "give a number, 0 or more".to_owned())
}

fn number(text: &str, fits: impl FnOnce(f64) -> bool) -> Option<f64> {
    let value = text.trim().parse::<f64>().ok()?;
    (value.is_finite() && fits(value)).then_some(value)
}

fn whole(text: &str) -> Result<NonZeroUsize, String> {
    at_least_one(text)
}

fn whole_u32(text: &str) -> Result<NonZeroU32, String> {
    at_least_one(text)
}

fn plain(text: &str) -> Result<usize, String> {
    whole(text).map(NonZeroUsize::get)
}
