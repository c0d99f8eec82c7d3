//! Figures of this process from the operating system, under the names that Prometheus clients
//! share.

use std::{fs, sync::OnceLock, time::SystemTime};

use prometheus_client::{
    collector::Collector,
    encoding::{DescriptorEncoder, EncodeMetric},
    metrics::{counter::ConstCounter, gauge::ConstGauge},
};

use crate::resident::memory_bytes;

/// Clock ticks a second in `/proc` (Linux fixes it for programs).
const TICKS: f64 = 100.0;

/// Reads `/proc` at every scrape; without it nothing is reported.
#[derive(Debug, Default)]
pub(super) struct ProcessCollector {
    /// Start of the process since 1970 in seconds. Computed once: the two clocks that it comes from
    /// are never read at the same moment.
    started: OnceLock<Option<f64>>,
}

/// Figures of this process.
struct Figures {
    cpu_seconds: f64,
    resident_bytes: f64,
    open_fds: f64,
    threads: f64,
    started: f64,
}

impl Collector for ProcessCollector {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> Result<(), std::fmt::Error> {
        let Some(figures) = self.read() else {
            return Ok(());
        };
        let cpu = ConstCounter::new(figures.cpu_seconds);
        let described = encoder.encode_descriptor(
            "process_cpu_seconds",
            "Processor time of the process",
            None,
            cpu.metric_type(),
        )?;
        cpu.encode(described)?;
        for (name, help, value) in [
            ("process_resident_memory_bytes", "Memory of the process", figures.resident_bytes),
            ("process_open_fds", "Open file descriptors", figures.open_fds),
            ("process_threads", "Threads", figures.threads),
            ("process_start_time_seconds", "Start of the process since 1970", figures.started),
        ] {
            let gauge = ConstGauge::new(value);
            let described = encoder.encode_descriptor(name, help, None, gauge.metric_type())?;
            gauge.encode(described)?;
        }
        Ok(())
    }
}

impl ProcessCollector {
    fn read(&self) -> Option<Figures> {
        let stat = fs::read_to_string("/proc/self/stat").ok()?;
        // The name in parentheses may hold spaces.
        let (_, fields) = stat.rsplit_once(") ")?;
        let fields: Vec<f64> =
            fields.split_whitespace().map(|field| field.parse().unwrap_or_default()).collect();
        // Numbered as in proc_pid_stat(5), which counts the two before.
        let field = |number: usize| fields.get(number - 3).copied();
        let start_ticks = field(22)?;
        Some(Figures {
            cpu_seconds: (field(14)? + field(15)?) / TICKS,
            resident_bytes: memory_bytes("VmRSS:")? as f64,
            open_fds: fs::read_dir("/proc/self/fd").ok()?.count() as f64,
            threads: field(20)?,
            started: (*self.started.get_or_init(|| Some(booted()? + start_ticks / TICKS)))?,
        })
    }
}

/// Returns the start of the operating system since 1970 in seconds.
fn booted() -> Option<f64> {
    let uptime = fs::read_to_string("/proc/uptime").ok()?;
    let uptime: f64 = uptime.split_whitespace().next()?.parse().ok()?;
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    Some(now.ok()?.as_secs_f64() - uptime)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn figures_are_those_of_a_living_process() {
        let collector = ProcessCollector::default();
        let figures = collector.read().unwrap();
        assert!(figures.resident_bytes > 1e6);
        assert!(figures.open_fds >= 3.0);
        assert!(figures.threads >= 1.0);
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let age = now.unwrap().as_secs_f64() - figures.started;
        assert!((0.0..3600.0).contains(&age), "{age}");
        // The start is the same at every scrape.
        std::thread::sleep(std::time::Duration::from_millis(3));
        assert_eq!(collector.read().unwrap().started, figures.started);
    }
}
