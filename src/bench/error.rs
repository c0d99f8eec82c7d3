//! Why a figure could not be measured.

use crate::{
    audio::AudioError, engine::EngineError, features::FeatureError, formats::FormatError,
    model::ModelError,
};

/// Why a figure could not be measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// A generation failed.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The song could not be decoded.
    #[error(transparent)]
    Audio(#[from] AudioError),
    /// The song's features could not be computed.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The model failed.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A dance could not be written.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A caller's thread panicked.
    #[error("a caller failed unexpectedly")]
    Panicked,
}

pub(super) type Result<T, E = BenchError> = std::result::Result<T, E>;
