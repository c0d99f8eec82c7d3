//! The line of progress of a stage.

use std::{fs, io::Write, time::Instant};

/// Counts the time of a stage since this process took it up.
pub(super) struct Progress {
    stage: &'static str,
    start: Instant,
    first_step: u64,
    total: u64,
}

impl Progress {
    pub(super) fn start(stage: &'static str, first_step: u64, total: u64) -> Self {
        Self { stage, start: Instant::now(), first_step, total }
    }

    pub(super) fn seconds(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// Prints a line. Progress that cannot be shown is no reason to stop.
    pub(super) fn show(&self, done: u64, losses: &str, output: &mut impl Write) {
        let (stage, total) = (self.stage, self.total);
        let each = self.seconds() / done.saturating_sub(self.first_step).max(1) as f64;
        let left = clock(each * total.saturating_sub(done) as f64);
        let memory = memory();
        let _ = writeln!(
            output,
            "{stage} {done}/{total}  {losses}  {each:.3} s/step  {left} left{memory}"
        );
    }
}

/// Seconds as hours, minutes and seconds.
fn clock(seconds: f64) -> String {
    let seconds = seconds.ceil() as u64;
    let (hours, minutes) = (seconds / 3600, seconds / 60 % 60);
    format!("{hours}:{minutes:02}:{:02}", seconds % 60)
}

/// Returns the most memory used so far, where the system knows it.
fn memory() -> String {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.map_or_else(String::new, |kilobytes| format!("  {:.2} GB at most", kilobytes / 1e6))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_is_told_in_hours_minutes_and_seconds() {
        let told = [0.0, 59.2, 60.0, 25_384.0, 360_000.0].map(clock);
        assert_eq!(told, ["0:00:00", "0:01:00", "0:01:00", "7:03:04", "100:00:00"]);
    }

    #[test]
    fn a_line_says_where_the_stage_is() {
        let mut output = Vec::new();
        Progress::start("gpt", 0, 10).show(10, "loss 0.50000", &mut output);
        let line = String::from_utf8(output).unwrap();
        assert!(line.starts_with("gpt 10/10  loss 0.50000  "), "{line}");
        assert!(line.contains(" s/step  0:00:00 left"), "{line}");
    }
}
