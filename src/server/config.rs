//! Settings of the server: one flag each, the same as an environment variable; flag beats
//! environment beats default.

use std::{cmp::Ordering, fmt, num::NonZeroUsize, path::PathBuf, str::FromStr, time::Duration};

use clap::builder::FalseyValueParser;
use serde::{Serialize, Serializer};
use utoipa::ToSchema;

use crate::{
    audio::AudioLimits,
    engine::{DEFAULT_BATCH, EngineConfig},
};

/// Settings of `serve`.
#[derive(Clone, Debug, clap::Args)]
pub struct ServerConfig {
    /// Address to listen on; 0.0.0.0 for every network interface
    #[arg(long, env = "BAILANDO_HOST", default_value_t = ServerConfig::default().host)]
    pub host: String,
    /// Port to listen on; 0 picks a free one, which the log names
    #[arg(long, env = "BAILANDO_PORT", default_value_t = ServerConfig::default().port)]
    pub port: u16,
    /// Model directory
    #[arg(
        long,
        env = "BAILANDO_MODEL_DIR",
        default_value_os_t = ServerConfig::default().model_dir
    )]
    pub model_dir: PathBuf,
    /// Threads that compute one step of the model [default: all cores]
    #[arg(long, env = "BAILANDO_THREADS")]
    pub threads: Option<NonZeroUsize>,
    /// What a caller may ask for.
    #[command(flatten)]
    pub limits: Limits,
    /// Write the log as JSON lines
    #[arg(long, env = "BAILANDO_JSON_OUTPUT", value_parser = FalseyValueParser::new())]
    pub json_output: bool,
}

impl Default for ServerConfig {
    fn default() -> Self {
        Self {
            host: "127.0.0.1".to_owned(),
            port: 8080,
            model_dir: PathBuf::from("models/default"),
            threads: None,
            limits: Limits::default(),
            json_output: false,
        }
    }
}

impl ServerConfig {
    /// What the engine needs of these settings.
    #[must_use]
    pub fn engine(&self) -> EngineConfig {
        let cores = || std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        EngineConfig {
            model_dir: self.model_dir.clone(),
            threads: self.threads.map_or_else(cores, NonZeroUsize::get),
            batch: self.limits.batch.get(),
            // Only a request that holds a permit asks the model for anything.
            queue: self.limits.max_concurrent_requests.get(),
            audio: self.limits.audio(),
        }
    }
}

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
        Ok(())
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

/// A number of bytes; read from `25MB`, `512KiB` or plain bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(transparent)]
pub struct ByteSize(pub u64);

const BYTE_UNITS: [(&str, u64); 6] = [
    ("KiB", 1 << 10),
    ("MiB", 1 << 20),
    ("GiB", 1 << 30),
    ("kB", 1_000),
    ("MB", 1_000_000),
    ("GB", 1_000_000_000),
];

impl FromStr for ByteSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let text = text.trim();
        let digits = text.trim_end_matches(|c: char| !c.is_ascii_digit());
        let unit = text.get(digits.len()..).unwrap_or_default().trim();
        let scale = match unit {
            "" | "B" => Some(1),
            _ => BYTE_UNITS
                .iter()
                .find(|(name, _)| name.eq_ignore_ascii_case(unit))
                .map(|(_, scale)| *scale),
        };
        digits
            .parse::<u64>()
            .ok()
            .zip(scale)
            .and_then(|(count, scale)| count.checked_mul(scale))
            .map(Self)
            .ok_or_else(|| "give bytes, or a whole number with kB, MB, KiB or MiB".to_owned())
    }
}

impl fmt::Display for ByteSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = BYTE_UNITS
            .iter()
            .rev()
            .find(|(_, scale)| self.0 > 0 && self.0.is_multiple_of(*scale));
        match unit {
            Some((name, scale)) => write!(f, "{}{name}", self.0 / scale),
            None => write!(f, "{}B", self.0),
        }
    }
}

/// A length of time; read from and written as seconds, with decimals if wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Seconds(pub Duration);

impl Seconds {
    /// Whole seconds.
    #[must_use]
    pub const fn new(seconds: u64) -> Self {
        Self(Duration::from_secs(seconds))
    }

    /// Rounded up to whole seconds and at least one, as `Retry-After` wants it.
    pub(crate) fn retry_after(self) -> u64 {
        let up = u64::from(self.0.subsec_nanos() > 0);
        self.0.as_secs().saturating_add(up).max(1)
    }
}

impl FromStr for Seconds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        text.trim()
            .parse::<f64>()
            .ok()
            .and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
            .filter(|time| !time.is_zero())
            .map(Self)
            .ok_or_else(|| "give a number of seconds above 0".to_owned())
    }
}

impl fmt::Display for Seconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.as_secs_f64())
    }
}

impl Serialize for Seconds {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(self.0.as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        config: ServerConfig,
    }

    #[test]
    fn flags_are_read_and_defaults_are_those_of_the_struct() {
        let parsed = Command::try_parse_from([
            "serve",
            "--port",
            "0",
            "--payload-limit",
            "1MiB",
            "--request-timeout",
            "1.5",
            "--json-output",
        ])
        .unwrap()
        .config;
        assert_eq!(parsed.port, 0);
        assert_eq!(parsed.limits.payload_limit, ByteSize(1_048_576));
        assert_eq!(
            parsed.limits.request_timeout.0,
            Duration::from_millis(1_500)
        );
        assert!(parsed.json_output);
        let defaults = Command::try_parse_from(["serve"]).unwrap().config;
        assert_eq!(defaults.limits, Limits::default());
        assert_eq!(defaults.limits.max_concurrent_requests.get(), 4);
        assert_eq!(defaults.limits.audio(), AudioLimits::default());
    }

    #[test]
    fn sizes_and_times_that_mean_nothing_are_refused() {
        for text in ["", "MB", "-1", "12 apples", "1.5MB", "99999999999GB"] {
            assert!(text.parse::<ByteSize>().is_err(), "{text:?}");
        }
        for text in ["", "0", "-1", "NaN", "inf", "1e300", "soon"] {
            assert!(text.parse::<Seconds>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn limits_that_mean_nothing_are_refused() {
        for (flag, values) in [
            (
                "--max-audio-seconds",
                &["nan", "-5", "0", "inf", "long"][..],
            ),
            ("--min-audio-seconds", &["nan", "-0.1", "-inf"]),
            ("--min-sample-rate", &["0", "-1", "4294967296"]),
            ("--max-sample-rate", &["0"]),
            ("--max-channels", &["0", "-1"]),
        ] {
            for value in values {
                let given = format!("{flag}={value}");
                assert!(
                    Command::try_parse_from(["serve", &given]).is_err(),
                    "{given}"
                );
            }
        }
        assert!(Command::try_parse_from(["serve", "--min-audio-seconds=0"]).is_ok());
    }

    #[test]
    fn the_bounds_of_a_range_are_in_order() {
        assert_eq!(Limits::default().check(), Ok(()));
        let limits = Limits {
            min_audio_seconds: 10.0,
            max_audio_seconds: 5.0,
            ..Limits::default()
        };
        assert_eq!(
            limits.check().unwrap_err().to_string(),
            "--min-audio-seconds 10 must not be above --max-audio-seconds 5"
        );
        let limits = Limits {
            max_audio_seconds: f64::NAN,
            ..Limits::default()
        };
        assert!(limits.check().is_err());
        let limits = Limits {
            min_sample_rate: 48_000,
            max_sample_rate: 44_100,
            ..Limits::default()
        };
        assert!(matches!(
            limits.check(),
            Err(LimitsError::SampleRate { .. })
        ));
    }

    #[test]
    fn what_is_shown_reads_back_the_same() {
        for bytes in [0, 1, 1_000, 1_024, 25_000_000, 104_857_600, 12_345] {
            let size = ByteSize(bytes);
            assert_eq!(size.to_string().parse(), Ok(size));
        }
        assert_eq!(ByteSize(25_000_000).to_string(), "25MB");
        assert_eq!("0.25".parse::<Seconds>().unwrap().to_string(), "0.25");
    }

    #[test]
    fn no_retry_after_is_zero_or_too_early() {
        assert_eq!(Seconds(Duration::from_millis(1)).retry_after(), 1);
        assert_eq!(Seconds(Duration::from_millis(2_001)).retry_after(), 3);
        assert_eq!(Seconds::new(2).retry_after(), 2);
    }
}
