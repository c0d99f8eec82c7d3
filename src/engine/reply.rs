//! Where an outcome goes.

use std::sync::atomic::{AtomicBool, Ordering};

use crossbeam_channel::Sender;

use super::{EngineError, worker::Outcome};
use crate::Result;

/// Who waits for an outcome. Dropped before it was given, it says that the model has stopped.
pub(crate) struct Reply {
    outcome: Sender<Result<Outcome>>,
    given: AtomicBool,
}

impl Reply {
    pub(crate) fn new(outcome: Sender<Result<Outcome>>) -> Self {
        Self {
            outcome,
            given: AtomicBool::new(false),
        }
    }

    /// Answers; only the first answer is heard.
    pub(crate) fn give(&self, result: Result<Outcome>) {
        self.given.store(true, Ordering::Relaxed);
        // Full when the request was cancelled meanwhile: it has its answer then.
        let _ = self.outcome.try_send(result);
    }

    /// Whether there was an answer: nothing more needs to be done.
    pub(crate) fn is_given(&self) -> bool {
        self.given.load(Ordering::Relaxed)
    }
}

impl Drop for Reply {
    /// After an answer nobody listens any more.
    fn drop(&mut self) {
        self.give(Err(EngineError::Stopped.into()));
    }
}
