//! Counters, gauges and histograms, in the format that Prometheus reads.

mod process;

use std::{
    fmt,
    sync::{Arc, OnceLock, atomic::AtomicU64},
    time::{Duration, Instant},
};

use bytes::Bytes;
use parking_lot::Mutex;
use prometheus_client::{
    encoding::text::encode,
    metrics::{
        counter::Counter,
        family::Family,
        gauge::Gauge,
        histogram::{Histogram, exponential_buckets},
        info::Info,
    },
    registry::{Registry, Unit},
};

use self::process::ProcessCollector;
use crate::{engine::Observer, formats::Timings};

/// One label with a value of ours; one, and three, with any value.
type One = [(&'static str, &'static str); 1];
type Any = [(&'static str, String); 1];
type Three = [(&'static str, String); 3];

/// Scrapes within this time have the same text.
const MOMENT: Duration = Duration::from_millis(100);

type Histograms<L> = Family<L, Histogram, fn() -> Histogram>;

/// Defines all metrics: visibility, field, type and first value, name, unit if any, and help. A
/// unit is appended to the name.
macro_rules! metrics {
    ($(
        $visibility:vis $field:ident: $type:ty = $value:expr,
            $name:literal $(in $unit:ident)?, $help:literal;
    )+) => {
        /// All metrics of one server.
        pub struct Metrics {
            registry: Registry,
            model: OnceLock<String>,
            // Held while a scrape is written, which takes less than a millisecond.
            last_text: Mutex<Option<(Instant, Bytes)>>,
            $(#[doc = $help] $visibility $field: $type,)+
        }

        impl Default for Metrics {
            fn default() -> Self {
                let mut registry = Registry::default();
                registry.register_collector(Box::new(ProcessCollector::default()));
                let ours = registry.sub_registry_with_prefix("bailando");
                $(
                    let $field: $type = $value;
                    metrics!(register ours $field $name $help $($unit)?);
                )+
                Self {
                    registry,
                    model: OnceLock::new(),
                    last_text: Mutex::default(),
                    $($field,)+
                }
            }
        }
    };
    (register $ours:ident $field:ident $name:literal $help:literal) => {
        $ours.register($name, $help, $field.clone());
    };
    (register $ours:ident $field:ident $name:literal $help:literal $unit:ident) => {
        $ours.register_with_unit($name, $help, Unit::$unit, $field.clone());
    };
}

metrics! {
    requests: Family<Three, Counter> = Family::default(),
        "http_requests", "Requests answered";
    pub(crate) queue_waiting: Gauge = Gauge::default(),
        "queue_waiting", "Requests that wait for a worker";
    pub(crate) running: Gauge = Gauge::default(),
        "requests_running", "Requests that are being processed";
    batch_rows: Histogram
        = Histogram::new([1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0]),
        "batch_rows", "Sequences that share a step of the model, candidates counted";
    codes: Counter = Counter::default(),
        "codes", "Pairs of pose codes generated";
    dances: Family<One, Counter> = Family::default(),
        "dances", "Generations completed";
    cancelled: Family<One, Counter> = Family::default(),
        "cancelled", "Requests whose client disconnected, whose time was over, or whose job was \
        deleted, by phase";
    rejected: Family<Any, Counter> = Family::default(),
        "rejected", "Requests refused, by reason";
    panics: Family<One, Counter> = Family::default(),
        "panics", "Panics caught, by place";
    failed_steps: Counter = Counter::default(),
        "failed_steps", "Steps of the model that failed for all sequences that shared them";
    pub(crate) connections: Gauge = Gauge::default(),
        "connections", "Open connections";
    pub(crate) uploads: Gauge = Gauge::default(),
        "uploads", "Bodies in transfer";
    jobs: Family<One, Gauge> = Family::default(),
        "jobs", "Jobs kept, by state, of all replicas that share them";
    pub(crate) job_retries: Counter = Counter::default(),
        "job_retries", "Jobs put back after a fault of the service";
    pub(crate) callbacks: Family<One, Counter> = Family::default(),
        "callbacks", "Reports of the end of a job to its callback URL, by outcome";
    pub(crate) answer_bytes: Gauge = Gauge::default(),
        "answer" in Bytes, "Bytes of responses held for their readers";
    pub(crate) upload_bytes: Gauge = Gauge::default(),
        "upload" in Bytes, "Bytes of uploads held until they are decoded";
    request_duration: Histograms<Any> = Family::new_with_constructor(long),
        "http_request_duration" in Seconds, "From the head of a request to that of its response";
    queue_wait: Histogram = long(),
        "queue_wait" in Seconds, "Waiting for a worker";
    step_duration: Histogram = short(),
        "step_duration" in Seconds, "One step of the model for a whole batch";
    stage_duration: Histograms<One> = Family::new_with_constructor(long),
        "stage_duration" in Seconds, "Stages of a generation";
    audio_seconds: Counter<f64, AtomicU64> = Counter::default(),
        "audio" in Seconds, "Audio decoded for generations";
    cancel_latency: Histogram = short(),
        "cancel_latency" in Seconds, "From the disconnection of a client to the end of its work";
    pub(crate) audio_in_flight: Gauge = Gauge::default(),
        "audio_seconds_in_flight", "Audio that is being processed";
}

fn long() -> Histogram {
    Histogram::new(exponential_buckets(0.005, 2.0, 16))
}

fn short() -> Histogram {
    Histogram::new(exponential_buckets(0.000_5, 2.0, 14))
}

impl Metrics {
    /// Names the model in `bailando_build_info`.
    pub(crate) fn loaded(&self, model: &str) {
        self.model.get_or_init(|| model.to_owned());
    }

    /// Returns the text of a scrape, the same one for all who ask within a moment: however many do,
    /// there are few of it.
    pub(crate) fn shared_text(&self) -> Result<Bytes, fmt::Error> {
        let mut last = self.last_text.lock();
        if let Some((at, text)) = &*last
            && at.elapsed() < MOMENT
        {
            return Ok(text.clone());
        }
        let text = Bytes::from(self.text()?);
        *last = Some((Instant::now(), text.clone()));
        Ok(text)
    }

    /// Returns the text of a scrape.
    pub(crate) fn text(&self) -> Result<String, fmt::Error> {
        let mut text = String::new();
        let mut info = Registry::with_prefix("bailando");
        let build = vec![
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("model", self.model.get().cloned().unwrap_or_default()),
        ];
        info.register("build", "Version and model of this server", Info::new(build));
        prometheus_client::encoding::text::encode_registry(&mut text, &info)?;
        encode(&mut text, &self.registry)?;
        Ok(text)
    }

    pub(crate) fn answered(&self, route: &str, method: &str, status: u16, took: Duration) {
        let labels = [
            ("route", route.to_owned()),
            ("method", method.to_owned()),
            ("status", status.to_string()),
        ];
        self.requests.get_or_create(&labels).inc();
        self.request_duration
            .get_or_create(&[("route", route.to_owned())])
            .observe(took.as_secs_f64());
    }

    pub(crate) fn waited(&self, time: Duration) {
        self.queue_wait.observe(time.as_secs_f64());
    }

    pub(crate) fn heard(&self, seconds: f64) {
        self.audio_seconds.inc_by(seconds);
    }

    /// Counts a generation of `kind` with so many codes.
    pub(crate) fn danced(&self, kind: &'static str, codes: usize, timings: &Timings) {
        self.dances.get_or_create(&[("kind", kind)]).inc();
        self.codes.inc_by(codes as u64);
        for (stage, time) in [
            ("decode", timings.decode),
            ("features", timings.features),
            ("inference", timings.inference),
        ] {
            self.stage(stage, time);
        }
        // That of a stream is known at its end.
        if kind != "stream" {
            self.stage("motion", timings.motion);
        }
    }

    pub(crate) fn stage(&self, stage: &'static str, time: Duration) {
        self.stage_duration.get_or_create(&[("stage", stage)]).observe(time.as_secs_f64());
    }

    pub(crate) fn cancelled(&self, phase: &'static str, took: Duration) {
        self.cancelled.get_or_create(&[("phase", phase)]).inc();
        self.cancel_latency.observe(took.as_secs_f64());
    }

    pub(crate) fn rejected(&self, reason: &str) {
        self.rejected.get_or_create(&[("reason", reason.to_owned())]).inc();
    }

    pub(crate) fn panicked(&self, place: &'static str) {
        self.panics.get_or_create(&[("place", place)]).inc();
    }

    /// Says how many jobs are in `state`, of all replicas that share them.
    pub(crate) fn jobs(&self, state: &'static str, jobs: i64) {
        self.jobs.get_or_create(&[("state", state)]).set(jobs);
    }
}

impl Observer for Metrics {
    fn stepped(&self, rows: usize, took: Duration) {
        self.batch_rows.observe(rows as f64);
        self.step_duration.observe(took.as_secs_f64());
    }

    fn step_failed(&self) {
        self.failed_steps.inc();
    }
}

impl fmt::Debug for Metrics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Metrics").finish_non_exhaustive()
    }
}

/// Handle to the metrics of a server.
pub(crate) type SharedMetrics = Arc<Metrics>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_documented_ones() {
        let metrics = Metrics::default();
        metrics.loaded("tiny");
        metrics.answered("/generate", "POST", 200, Duration::from_millis(3));
        metrics.danced("generate", 5, &Timings::default());
        metrics.cancelled("upload", Duration::ZERO);
        metrics.rejected("queue_full");
        Metrics::panicked(&metrics, "decode");
        metrics.heard(2.5);
        metrics.stepped(3, Duration::from_millis(1));
        metrics.jobs("running", 1);
        let text = metrics.text().unwrap();
        for line in [
            "bailando_build_info{version=\"0.1.0\",model=\"tiny\"} 1",
            "bailando_http_requests_total{route=\"/generate\",method=\"POST\",status=\"200\"} 1",
            "bailando_http_request_duration_seconds_count{route=\"/generate\"} 1",
            "bailando_queue_waiting 0",
            "bailando_requests_running 0",
            "bailando_queue_wait_seconds_count 0",
            "bailando_batch_rows_bucket{le=\"3.0\"} 1",
            "bailando_step_duration_seconds_count 1",
            "bailando_stage_duration_seconds_count{stage=\"decode\"} 1",
            "bailando_audio_seconds_total 2.5",
            "bailando_codes_total 5",
            "bailando_dances_total{kind=\"generate\"} 1",
            "bailando_cancelled_total{phase=\"upload\"} 1",
            "bailando_cancel_latency_seconds_count 1",
            "bailando_rejected_total{reason=\"queue_full\"} 1",
            "bailando_panics_total{place=\"decode\"} 1",
            "bailando_connections 0",
            "bailando_uploads 0",
            "bailando_upload_bytes 0",
            "bailando_audio_seconds_in_flight 0",
            "bailando_jobs{state=\"running\"} 1",
        ] {
            assert!(text.lines().any(|found| found == line), "{line}\n{text}");
        }
        assert!(text.ends_with("# EOF\n"));
    }
}
