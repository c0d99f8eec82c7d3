//! What an engine does, for whoever counts it.

use std::{fmt, time::Duration};

/// Hears what the model's thread does; must not wait.
pub trait Observer: fmt::Debug + Send + Sync {
    /// A step of the model for so many rows.
    fn stepped(&self, _rows: usize, _took: Duration) {}
    /// A panic was caught.
    fn panicked(&self) {}
}

/// Hears nothing.
impl Observer for () {}
