//! What an engine does, for whoever counts it.

use std::{
    fmt,
    panic::{self, AssertUnwindSafe},
    time::Duration,
};

use super::EngineError;
use crate::Result;

/// Hears what the model's threads do; must not wait.
pub trait Observer: fmt::Debug + Send + Sync {
    /// A step of the model for so many rows.
    fn stepped(&self, _rows: usize, _took: Duration) {}
    /// A panic was caught.
    fn panicked(&self) {}
}

/// Hears nothing.
impl Observer for () {}

/// A panic costs the request that it is about.
pub(super) fn guarded<T>(observer: &dyn Observer, work: impl FnOnce() -> Result<T>) -> Result<T> {
    panic::catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
        observer.panicked();
        Err(EngineError::Panicked.into())
    })
}
