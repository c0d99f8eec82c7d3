//! Figures of the engine's threads, and panics that are kept to one request.

use std::{
    any::Any,
    fmt,
    panic::{self, AssertUnwindSafe},
    time::Duration,
};

use super::EngineError;

/// Receives figures from the scheduler's thread; must not wait.
pub trait Observer: fmt::Debug + Send + Sync {
    /// A step of the model for so many rows succeeded or failed.
    fn stepped(&self, _rows: usize, _took: Duration) {}
    /// A step of the model failed for all requests that shared it.
    fn step_failed(&self) {}
}

/// Ignores everything.
impl Observer for () {}

/// Turns a panic of `work` into an error of the one request that it works for.
pub(super) fn guarded<T>(work: impl FnOnce() -> Result<T, EngineError>) -> Result<T, EngineError> {
    panic::catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let message = text(panic.as_ref()).to_owned();
        tracing::error!(message, "a generation panicked");
        Err(EngineError::Panicked { message })
    })
}

fn text(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("without a message")
}
