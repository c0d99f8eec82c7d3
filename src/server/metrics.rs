//! What is counted, in the form that Prometheus reads.

use std::{
    fmt,
    sync::{Arc, OnceLock},
    time::Duration,
};

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

use super::process::ProcessCollector;
use crate::{engine::Observer, formats::Timings};

/// One label of a value that is known beforehand; one, and three, of any.
type One = [(&'static str, &'static str); 1];
type Any = [(&'static str, String); 1];
type Three = [(&'static str, String); 3];

type Histograms<L> = Family<L, Histogram, fn() -> Histogram>;

/// All metrics of one server.
pub struct Metrics {
    registry: Registry,
    model: OnceLock<String>,
    requests: Family<Three, Counter>,
    request_duration: Histograms<Any>,
    queue_wait: Histogram,
    batch_rows: Histogram,
    step_duration: Histogram,
    stage_duration: Histograms<One>,
    audio_seconds: Counter<f64, std::sync::atomic::AtomicU64>,
    codes: Counter,
    dances: Family<One, Counter>,
    cancelled: Family<One, Counter>,
    cancel_latency: Histogram,
    rejected: Family<One, Counter>,
    panics: Family<One, Counter>,
    failed_steps: Counter,
    /// Requests that wait for their turn.
    pub(crate) queue_waiting: Gauge,
    /// Requests that are worked on.
    pub(crate) running: Gauge,
    /// Open connections.
    pub(crate) connections: Gauge,
    /// Bodies on their way.
    pub(crate) uploads: Gauge,
    /// Bytes of uploads that are held.
    pub(crate) upload_bytes: Gauge,
    /// Seconds of audio that are worked on.
    pub(crate) audio_in_flight: Gauge,
    jobs: Family<One, Gauge>,
}

impl Default for Metrics {
    fn default() -> Self {
        let long = || Histogram::new(exponential_buckets(0.005, 2.0, 16));
        let short = || Histogram::new(exponential_buckets(0.000_5, 2.0, 14));
        let mut metrics = Self {
            registry: Registry::default(),
            model: OnceLock::new(),
            requests: Family::default(),
            request_duration: Family::new_with_constructor(long as fn() -> Histogram),
            queue_wait: long(),
            batch_rows: Histogram::new([1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0]),
            step_duration: short(),
            stage_duration: Family::new_with_constructor(long as fn() -> Histogram),
            audio_seconds: Counter::default(),
            codes: Counter::default(),
            dances: Family::default(),
            cancelled: Family::default(),
            cancel_latency: short(),
            rejected: Family::default(),
            panics: Family::default(),
            failed_steps: Counter::default(),
            queue_waiting: Gauge::default(),
            running: Gauge::default(),
            connections: Gauge::default(),
            uploads: Gauge::default(),
            upload_bytes: Gauge::default(),
            audio_in_flight: Gauge::default(),
            jobs: Family::default(),
        };
        metrics.register();
        metrics
    }
}

impl Metrics {
    fn register(&mut self) {
        let registry = &mut self.registry;
        registry.register_collector(Box::new(ProcessCollector));
        let ours = registry.sub_registry_with_prefix("bailando");
        macro_rules! register {
            ($($name:literal, $help:literal, $metric:ident;)*) => {
                $(ours.register($name, $help, self.$metric.clone());)*
            };
            (in $unit:expr; $($name:literal, $help:literal, $metric:ident;)*) => {
                $(ours.register_with_unit($name, $help, $unit, self.$metric.clone());)*
            };
        }
        register! {
            "http_requests", "Requests answered", requests;
            "queue_waiting", "Requests that wait for their turn", queue_waiting;
            "requests_running", "Requests that are worked on", running;
            "batch_rows", "Dances that share a step of the model, candidates counted", batch_rows;
            "codes", "Pairs of pose codes generated", codes;
            "dances", "Dances made", dances;
            "cancelled", "Requests whose client left, whose time was over, or whose job was deleted, by phase", cancelled;
            "rejected", "Requests refused, by reason", rejected;
            "panics", "Panics caught, by place", panics;
            "failed_steps", "Steps of the model that failed for all dances that shared them", failed_steps;
            "connections", "Open connections", connections;
            "uploads", "Bodies on their way", uploads;
            "jobs", "Jobs kept, by state", jobs;
        }
        register! { in Unit::Bytes;
            "upload", "Bytes of uploads held until they are decoded", upload_bytes;
        }
        register! { in Unit::Seconds;
            "http_request_duration", "From a request's head to its answer's head", request_duration;
            "queue_wait", "Waiting for a turn", queue_wait;
            "step_duration", "One step of the model for a whole batch", step_duration;
            "stage_duration", "Stages of a dance", stage_duration;
            "audio", "Audio that was danced to", audio_seconds;
            "cancel_latency", "From a client's leaving to the end of its work", cancel_latency;
        }
        ours.register(
            "audio_seconds_in_flight",
            "Audio that is worked on",
            self.audio_in_flight.clone(),
        );
    }

    /// Names the model in `bailando_build_info`.
    pub(crate) fn loaded(&self, model: &str) {
        self.model.get_or_init(|| model.to_owned());
    }

    /// The text that a scrape is answered with.
    pub(crate) fn text(&self) -> Result<String, fmt::Error> {
        let mut text = String::new();
        let mut info = Registry::with_prefix("bailando");
        let build = vec![
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("model", self.model.get().cloned().unwrap_or_default()),
        ];
        info.register(
            "build",
            "Version and model of this server",
            Info::new(build),
        );
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

    /// A dance of `kind` with so many codes.
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
        // A stream's is known at its end.
        if kind != "stream" {
            self.stage("motion", timings.motion);
        }
    }

    pub(crate) fn stage(&self, stage: &'static str, time: Duration) {
        self.stage_duration
            .get_or_create(&[("stage", stage)])
            .observe(time.as_secs_f64());
    }

    pub(crate) fn cancelled(&self, phase: &'static str, took: Duration) {
        self.cancelled.get_or_create(&[("phase", phase)]).inc();
        self.cancel_latency.observe(took.as_secs_f64());
    }

    pub(crate) fn rejected(&self, reason: &'static str) {
        self.rejected.get_or_create(&[("reason", reason)]).inc();
    }

    pub(crate) fn panicked(&self, place: &'static str) {
        self.panics.get_or_create(&[("place", place)]).inc();
    }

    /// Counts one job in `state` for as long as the guard lives.
    pub(crate) fn job(&self, state: &'static str) -> Counted {
        Counted::new(&self.jobs.get_or_create(&[("state", state)]))
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

/// Counts in a gauge for as long as it lives.
#[derive(Debug)]
pub(crate) struct Counted(Gauge);

impl Counted {
    pub(crate) fn new(gauge: &Gauge) -> Self {
        gauge.inc();
        Self(gauge.clone())
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.dec();
    }
}

/// Handle to the metrics of a server.
pub(crate) type SharedMetrics = Arc<Metrics>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_that_are_documented() {
        let metrics = Metrics::default();
        metrics.loaded("tiny");
        metrics.answered("/generate", "POST", 200, Duration::from_millis(3));
        metrics.danced("generate", 5, &Timings::default());
        metrics.cancelled("upload", Duration::ZERO);
        metrics.rejected("queue_full");
        Metrics::panicked(&metrics, "decode");
        metrics.heard(2.5);
        metrics.stepped(3, Duration::from_millis(1));
        metrics.step_failed();
        let _job = metrics.job("running");
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
            "bailando_failed_steps_total 1",
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
