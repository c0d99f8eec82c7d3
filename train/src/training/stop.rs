//! Requests to stop, which a signal handler makes.

use std::sync::atomic::{AtomicBool, Ordering};

/// Asks a running stage to write a checkpoint and stop.
#[derive(Debug, Default)]
pub struct StopFlag {
    requested: AtomicBool,
    stepping: AtomicBool,
}

impl StopFlag {
    /// Returns a flag that nobody has raised.
    #[must_use]
    pub const fn new() -> Self {
        Self { requested: AtomicBool::new(false), stepping: AtomicBool::new(false) }
    }

    /// Asks to stop. Returns whether a stage will: if not, or if it was asked before, the process
    /// can end at once, for its last checkpoint is written.
    pub fn request(&self) -> bool {
        let first = !self.requested.swap(true, Ordering::SeqCst);
        first && self.stepping.load(Ordering::SeqCst)
    }

    /// Whether [`StopFlag::request`] was called.
    #[must_use]
    pub fn is_requested(&self) -> bool {
        self.requested.load(Ordering::SeqCst)
    }

    /// Says that a stage looks at the flag after each step, until the guard is dropped.
    pub(super) fn heeded(&self) -> Heeded<'_> {
        self.stepping.store(true, Ordering::SeqCst);
        Heeded(self)
    }
}

/// See [`StopFlag::heeded`].
pub(super) struct Heeded<'a>(&'a StopFlag);

impl Drop for Heeded<'_> {
    fn drop(&mut self) {
        self.0.stepping.store(false, Ordering::SeqCst);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_request_during_steps_is_heeded() {
        let flag = StopFlag::new();
        assert!(!flag.request(), "nothing runs");
        let flag = StopFlag::new();
        let heeded = flag.heeded();
        assert!(!flag.is_requested());
        assert!(flag.request());
        assert!(!flag.request(), "the second time the process ends at once");
        drop(heeded);
        assert!(flag.is_requested());
    }
}
