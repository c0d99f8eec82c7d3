//! Settings of the server: one flag each, the same as an environment variable; flag beats
//! environment beats default.

mod keys;
mod limits;
mod origin;
mod storage;
mod units;

use std::{num::NonZeroUsize, path::PathBuf, sync::Arc};

use clap::builder::FalseyValueParser;

pub(crate) use self::limits::FORM_OVERHEAD;
pub use self::{
    keys::{ApiKey, KeysError},
    limits::{Limits, LimitsError},
    origin::Origin,
    storage::{Role, StorageConfig, StorageError},
    units::{ByteSize, Seconds, at_least_one},
};
use crate::{
    engine::{EngineConfig, Observer},
    model::Device,
};

/// API keys, allowed origins, and whether people find a page.
#[derive(Clone, Debug, Default)]
pub struct Access {
    /// Keys that callers must send one of; without any, every caller is accepted.
    pub keys: Vec<ApiKey>,
    /// Origins whose pages may call (CORS); `*` for all.
    pub origins: Vec<Origin>,
    /// Host names that requests may name; without any, every one.
    pub hosts: Vec<String>,
    /// Whether `/` leads to the documentation instead of the viewer.
    pub no_viewer: bool,
}

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
    /// What computes the model: cpu, or cuda or cuda:N for an NVIDIA GPU, which needs an ONNX
    /// Runtime library with CUDA (`scripts/fetch-onnxruntime.sh --cuda`)
    #[arg(long, env = "BAILANDO_DEVICE", default_value_t = ServerConfig::default().device)]
    pub device: Device,
    /// Threads that compute one step of the model [default: all cores]
    #[arg(long, env = "BAILANDO_THREADS", value_parser = at_least_one::<NonZeroUsize>)]
    pub threads: Option<NonZeroUsize>,
    /// Bounds of what callers may ask for.
    #[command(flatten)]
    pub limits: Limits,
    /// Where jobs are kept, and who works on them.
    #[command(flatten)]
    pub storage: StorageConfig,
    /// Key that callers must send, as `Authorization: Bearer KEY` or `X-API-Key: KEY`; several with
    /// commas. Probes, metrics and documentation need none [default: no key is required]
    #[arg(long, env = "BAILANDO_API_KEY", hide_env_values = true, value_delimiter = ',')]
    pub api_key: Vec<ApiKey>,
    /// File of API keys, one a line, in addition to --api-key
    #[arg(long, env = "BAILANDO_API_KEY_FILE")]
    pub api_key_file: Option<PathBuf>,
    /// Origins whose pages may call the server (CORS), each a scheme, a host and perhaps a port;
    /// several with commas; * for all [default: none]
    #[arg(long, env = "BAILANDO_CORS_ALLOW_ORIGIN", value_delimiter = ',')]
    pub cors_allow_origin: Vec<Origin>,
    /// Host names that requests may name, without ports; several with commas: a page on another
    /// name that resolves to this server is refused then. Probes may name any [default: all]
    #[arg(long, env = "BAILANDO_ALLOWED_HOST", value_delimiter = ',')]
    pub allowed_host: Vec<String>,
    /// Serve no viewer: / leads to the documentation instead
    #[arg(long, env = "BAILANDO_NO_VIEWER", value_parser = FalseyValueParser::new())]
    pub no_viewer: bool,
    /// Collector that traces are sent to: OTLP over HTTP, such as http://localhost:4318 [default:
    /// none]
    #[arg(long, env = "BAILANDO_OTLP_ENDPOINT")]
    pub otlp_endpoint: Option<String>,
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
            device: Device::Cpu,
            threads: None,
            limits: Limits::default(),
            storage: StorageConfig::default(),
            api_key: Vec::new(),
            api_key_file: None,
            cors_allow_origin: Vec::new(),
            allowed_host: Vec::new(),
            no_viewer: false,
            otlp_endpoint: None,
            json_output: false,
        }
    }
}

impl ServerConfig {
    /// Returns the API keys of the settings and of the key file, and the rest of who may see what.
    ///
    /// # Errors
    /// [`KeysError`] if the file cannot be read or holds no key.
    pub fn access(&self) -> Result<Access, KeysError> {
        let given = self.api_key.iter().filter(|key| !key.is_empty());
        let mut keys: Vec<ApiKey> = given.cloned().collect();
        // A variable that was meant to hold a key must not open the server.
        if keys.is_empty() && !self.api_key.is_empty() {
            return Err(KeysError::Empty);
        }
        if let Some(path) = &self.api_key_file {
            keys.extend(keys::read(path)?);
        }
        Ok(Access {
            keys,
            origins: self.cors_allow_origin.clone(),
            hosts: self.allowed_host.clone(),
            no_viewer: self.no_viewer,
        })
    }

    /// Returns the engine's part of the settings.
    #[must_use]
    pub fn engine(&self, observer: Arc<dyn Observer>) -> EngineConfig {
        let cores = || std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        EngineConfig {
            model_dir: self.model_dir.clone(),
            device: self.device,
            threads: self.threads.map_or_else(cores, NonZeroUsize::get),
            batch: self.limits.batch.get(),
            // Only requests with a permit use the model.
            queue: self.limits.max_concurrent_requests.get(),
            songs: self.limits.max_concurrent_requests.get(),
            audio: self.limits.audio(),
            effort: self.limits.effort(),
            observer,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use clap::Parser;

    use super::*;
    use crate::audio::AudioLimits;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        config: ServerConfig,
    }

    #[test]
    fn flags_are_read_and_defaults_are_those_of_the_struct() {
        let flags = "serve --port 0 --payload-limit 1MiB --request-timeout 1.5 --json-output";
        let parsed = Command::try_parse_from(flags.split(' ')).unwrap().config;
        assert_eq!(parsed.port, 0);
        assert_eq!(parsed.limits.payload_limit, ByteSize(1_048_576));
        let timeout = parsed.limits.request_timeout.0;
        assert_eq!(timeout, Duration::from_millis(1_500));
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
        for text in " 0 -1 NaN inf 1e300 1e19 315360001 soon".split(' ') {
            assert!(text.parse::<Seconds>().is_err(), "{text:?}");
        }
        assert_eq!("315360000".parse(), Ok(Seconds::new(315_360_000)));
    }

    #[test]
    fn limits_that_mean_nothing_are_refused() {
        let parse = |given: &str| Command::try_parse_from(["serve", given]);
        for (flag, values) in [
            ("--max-audio-seconds", "nan -5 0 inf long"),
            ("--min-audio-seconds", "nan -0.1 -inf"),
            ("--min-sample-rate", "0 -1 4294967296"),
            ("--max-sample-rate", "0"),
            ("--max-channels", "0 -1"),
            ("--threads", "0 -1 two"),
            ("--rate-limit", "0 -1 4294967296"),
            ("--max-jobs", "0"),
        ] {
            for value in values.split(' ') {
                let given = format!("{flag}={value}");
                let refused = parse(&given).map(|_| given).unwrap_err().to_string();
                let says = refused.contains(": give a ") || refused.contains("is not in 1..");
                assert!(says, "{refused}");
            }
        }
        assert!(parse("--min-audio-seconds=0").is_ok());
    }

    #[test]
    fn the_bounds_of_a_range_are_in_order() {
        assert_eq!(Limits::default().check(), Ok(()));
        let limits =
            Limits { min_audio_seconds: 10.0, max_audio_seconds: 5.0, ..Limits::default() };
        assert_eq!(
            limits.check().unwrap_err().to_string(),
            "--min-audio-seconds 10 must not be above --max-audio-seconds 5"
        );
        let limits = Limits { max_audio_seconds: f64::NAN, ..Limits::default() };
        assert!(limits.check().is_err());
        let limits =
            Limits { min_sample_rate: 48_000, max_sample_rate: 44_100, ..Limits::default() };
        assert!(matches!(limits.check(), Err(LimitsError::SampleRate { .. })));
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
