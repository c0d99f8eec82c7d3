//! Why a generation did not happen.

use std::io;

use crate::{audio::AudioError, features::FeatureError, model::ModelError, motion::MotionError};

/// Why a generation did not happen.
#[derive(Debug, thiserror::Error)]
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
    /// The engine's queue is full.
    #[error("the queue of {capacity} waiting generations is full: try again later")]
    QueueFull {
        /// Its size.
        capacity: usize,
    },
    /// The caller no longer wants the result.
    #[error("the generation was cancelled")]
    Cancelled,
    /// A defect of ours, caught: it costs this request only.
    #[error("the generation failed unexpectedly: {message}")]
    Panicked {
        /// Text of the panic.
        message: String,
    },
    /// A step of the model failed for all requests that shared it.
    #[error("a step of the model failed: {cause}")]
    StepFailed {
        /// What the model said.
        cause: String,
    },
    /// The operating system gives no random numbers.
    #[error("no seed could be drawn: {0}")]
    NoRandomness(String),
    /// The operating system gives no more threads.
    #[error("no thread could be started: {0}")]
    NoThread(io::Error),
    /// The engine has stopped.
    #[error("the model is no longer running")]
    Stopped,
    /// The upload could not be decoded, or lies outside the limits.
    #[error(transparent)]
    Audio(AudioError),
    /// The music features could not be computed.
    #[error(transparent)]
    Features(FeatureError),
    /// The model directory or ONNX Runtime failed.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The decoded motion is not usable.
    #[error(transparent)]
    Motion(#[from] MotionError),
}

impl From<AudioError> for EngineError {
    fn from(error: AudioError) -> Self {
        match error {
            AudioError::Cancelled => Self::Cancelled,
            other => Self::Audio(other),
        }
    }
}

impl From<FeatureError> for EngineError {
    fn from(error: FeatureError) -> Self {
        match error {
            FeatureError::Cancelled => Self::Cancelled,
            other => Self::Features(other),
        }
    }
}
