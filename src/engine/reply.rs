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

#[cfg(test)]
mod tests {
    use crossbeam_channel::bounded;

    use super::*;

    #[test]
    fn the_first_answer_is_heard_and_none_is_one_as_well() {
        let (sender, outcome) = bounded(1);
        let reply = Reply::new(sender);
        assert!(!reply.is_given());
        reply.give(Err(EngineError::Cancelled.into()));
        reply.give(Err(EngineError::Panicked.into()));
        assert!(reply.is_given());
        drop(reply);
        let heard: Vec<_> = outcome.iter().map(|result| result.unwrap_err()).collect();
        assert!(
            matches!(heard[..], [crate::Error::Engine(EngineError::Cancelled)]),
            "{heard:?}"
        );

        let (sender, outcome) = bounded(1);
        drop(Reply::new(sender));
        let heard = outcome.recv().unwrap().unwrap_err();
        assert!(matches!(heard, crate::Error::Engine(EngineError::Stopped)));
    }
}
