//! The library's one error type; every module's own error is a case of it.

use crate::{
    audio::AudioError, codebook::CodebookError, engine::EngineError, evaluation::EvaluationError,
    features::FeatureError, formats::FormatError, model::ModelError, motion::MotionError,
};

/// Anything that can go wrong between a song and a dance.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The upload could not be decoded, or lies outside the limits.
    #[error(transparent)]
    Audio(#[from] AudioError),
    /// The music features could not be computed.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The model directory or ONNX Runtime failed.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A skeleton or motion is not usable.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// A result could not be written in the wanted format.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Scheduling: bad options, full queue, cancelled.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// A codebook could not be shown.
    #[error(transparent)]
    Codebook(#[from] CodebookError),
    /// Sets of dances could not be compared.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
}

/// Shorthand for results with [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;
