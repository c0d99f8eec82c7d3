//! Why a generation did not happen.

use crate::{Error, model::ModelError};

/// A model's failure, or the cancellation that it was.
pub(super) fn of_model(error: ModelError) -> Error {
    match error {
        ModelError::Cancelled => EngineError::Cancelled.into(),
        other => other.into(),
    }
}

/// Why a generation did not happen.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// An option lies outside what this model accepts.
    #[error("option `{name}`: {problem}")]
    Option {
        /// Name of the option as in the API.
        name: &'static str,
        /// What was wrong and what is accepted.
        problem: String,
    },
    /// The model's queue is full.
    #[error("the queue of {capacity} waiting generations is full: try again later")]
    QueueFull {
        /// Its size.
        capacity: usize,
    },
    /// The caller no longer wants the result.
    #[error("the generation was cancelled")]
    Cancelled,
    /// A defect of ours, caught: it costs this request only.
    #[error("the generation failed unexpectedly")]
    Panicked,
    /// The operating system gives no random numbers.
    #[error("no seed could be drawn: {0}")]
    NoRandomness(String),
    /// The model thread has stopped.
    #[error("the model is no longer running")]
    Stopped,
}
