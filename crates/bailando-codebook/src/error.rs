//! The crate's error.

use std::path::PathBuf;

use bailando_model::ModelError;
use bailando_motion::MotionError;

/// Why a codebook could not be shown.
#[derive(Debug, thiserror::Error)]
pub enum CodebookError {
    /// A motion uses codes that the model does not have, or not in pairs.
    #[error("{0}")]
    Codes(String),
    /// A model's memory does not fit the model.
    #[error("{}: {problem}", path.display())]
    Memory {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The decoder failed.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The decoded motion is not usable.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// A sheet could not be drawn.
    #[error("the sheet can't be drawn: {0}")]
    Draw(String),
}

impl CodebookError {
    pub(crate) fn draw(error: impl std::fmt::Display) -> Self {
        Self::Draw(error.to_string())
    }
}
