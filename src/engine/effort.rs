//! Processor time that decoding a song may take: a small file that takes long is no song.

use std::{
    fs,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use crate::{CancelToken, audio::AudioRange};

/// How often the clock is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Processor time that decoding may take, by what is to be decoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecodeEffort {
    /// For any file.
    pub base: Duration,
    /// For each megabyte of it.
    pub per_megabyte: Duration,
    /// For each second of audio that is wanted.
    pub per_second: Duration,
}

impl Default for DecodeEffort {
    fn default() -> Self {
        Self {
            base: Duration::from_secs(1),
            per_megabyte: Duration::from_secs(1),
            per_second: Duration::from_millis(10),
        }
    }
}

impl DecodeEffort {
    /// The time for a file of `bytes`, of which at most `longest` seconds are wanted.
    pub(crate) fn of(&self, bytes: usize, range: AudioRange, longest: f64) -> Duration {
        let seconds = range.offset_s + range.duration_s.unwrap_or(longest);
        let seconds = if seconds.is_finite() { seconds.clamp(0.0, 2.0 * longest) } else { longest };
        let longer = self.per_megabyte.mul_f64(bytes as f64 / 1e6);
        self.base + longer + self.per_second.mul_f64(seconds)
    }
}

/// Cancels decoding on the thread that began it once its processor time is used up.
#[derive(Clone, Debug)]
pub(crate) struct Effort {
    pub(crate) limit: Duration,
    used_up: Arc<AtomicBool>,
}

impl Effort {
    /// A token that is cancelled when `cancel` is, or when this thread has worked for `limit` more.
    pub(crate) fn begin(limit: Duration, cancel: &CancelToken) -> (Self, CancelToken) {
        let effort = Self { limit, used_up: Arc::default() };
        let (used_up, cancel) = (Arc::clone(&effort.used_up), cancel.clone());
        let (begun, before) = (Instant::now(), worked());
        let look_at = AtomicU64::new(0);
        let token = CancelToken::when(move || {
            let wall = begun.elapsed();
            let now = wall.as_millis() as u64;
            if now >= look_at.load(Ordering::Relaxed) {
                look_at.store(now + LOOK_EVERY.as_millis() as u64, Ordering::Relaxed);
                let time = before.zip(worked()).map(|(before, now)| now.saturating_sub(before));
                if time.unwrap_or(wall) > limit {
                    used_up.store(true, Ordering::Relaxed);
                }
            }
            used_up.load(Ordering::Relaxed) || cancel.is_cancelled()
        });
        (effort, token)
    }

    pub(crate) fn is_used_up(&self) -> bool {
        self.used_up.load(Ordering::Relaxed)
    }
}

/// Processor time of this thread, where the system tells it.
fn worked() -> Option<Duration> {
    let text = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split(' ').next()?.parse().ok().map(Duration::from_nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_follows_the_size_and_the_length() {
        let effort = DecodeEffort::default();
        let all = AudioRange::default();
        assert_eq!(effort.of(2_000_000, all, 600.0), Duration::from_secs(9));
        let part = AudioRange { offset_s: 10.0, duration_s: Some(10.0) };
        assert_eq!(effort.of(0, part, 600.0), Duration::from_millis(1_200));
        let far = AudioRange { offset_s: 1e308, duration_s: None };
        assert_eq!(effort.of(0, far, 600.0), Duration::from_secs(13));
    }

    #[test]
    fn work_is_counted_and_waiting_is_not() {
        let (effort, token) = Effort::begin(Duration::from_millis(60), &CancelToken::new());
        if worked().is_some() {
            std::thread::sleep(Duration::from_millis(150));
            assert!(!token.is_cancelled());
        }
        let started = Instant::now();
        while !token.is_cancelled() {
            assert!(started.elapsed() < Duration::from_secs(20));
        }
        assert!(effort.is_used_up());
        let cancel = CancelToken::new();
        let (effort, token) = Effort::begin(Duration::from_secs(60), &cancel);
        assert!(!token.is_cancelled());
        cancel.cancel();
        assert!(token.is_cancelled() && !effort.is_used_up());
    }
}
