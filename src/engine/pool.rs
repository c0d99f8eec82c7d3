//! Things that are planned once and lent out, one per thread that needs one at a time.

use std::fmt;

use parking_lot::Mutex;

use super::EngineError;

/// A pool that makes a thing when none is idle.
pub(super) struct Pool<T> {
    make: Box<dyn Fn() -> Result<T, EngineError> + Send + Sync>,
    idle: Mutex<Vec<T>>,
}

impl<T> Pool<T> {
    pub(super) fn new(make: impl Fn() -> Result<T, EngineError> + Send + Sync + 'static) -> Self {
        Self { make: Box::new(make), idle: Mutex::new(Vec::new()) }
    }

    /// Lends a thing to `work`. One that saw a panic is not put back.
    pub(super) fn with<R>(
        &self,
        work: impl FnOnce(&mut T) -> Result<R, EngineError>,
    ) -> Result<R, EngineError> {
        let lent = self.idle.lock().pop();
        let mut lent = lent.map_or_else(&self.make, Ok)?;
        let result = work(&mut lent);
        self.idle.lock().push(lent);
        result
    }
}

impl<T> fmt::Debug for Pool<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pool").field("idle", &self.idle.lock().len()).finish_non_exhaustive()
    }
}
