//! Why a stage stopped.

use std::{
    io,
    path::{Path, PathBuf},
};

use crate::{
    checkpoint::CheckpointError, data::DataError, export::ExportError, weights::WeightError,
};

/// Why a stage stopped.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each message names its fields")]
pub enum TrainError {
    /// A file or folder could not be read or written.
    #[error("{}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// A configuration that cannot be used.
    #[error("{}: {message}", path.display())]
    Config { path: PathBuf, message: String },
    /// A data folder that cannot be used.
    #[error("{}: {message}", path.display())]
    Data { path: PathBuf, message: String },
    /// No piece of the training split is long enough.
    #[error("no training piece is long enough for a window of {length} {unit}")]
    TooShort { length: usize, unit: &'static str },
    /// A checkpoint of ours that cannot be used.
    #[error("{}: {message}", path.display())]
    State { path: PathBuf, message: String },
    /// Two processes would write each other's checkpoints.
    #[error("{}: another process is training there", folder.display())]
    Busy { folder: PathBuf },
    /// A stage that has to come before is not finished.
    #[error("{} is missing or not finished: run `bailando-train {stage}` first", path.display())]
    StageMissing { stage: &'static str, path: PathBuf },
    /// Something that a model with parts left out does not have.
    #[error("{what}: not with ablation.{flag} (generate its motion: `bailando-train generate`)")]
    LeftOut { what: &'static str, flag: &'static str },
    /// A loss is no number.
    #[error(
        "the {column} of {stage} is {value} around step {step}: the run stops here, and the last \
         checkpoint is from before (lower the rate, or set clip)"
    )]
    NotFinite { stage: &'static str, column: &'static str, value: f32, step: u64 },
    /// A device that is not there.
    #[error("device `{device}`: {message}")]
    Device { device: String, message: String },
    /// Training data that cannot be read.
    #[error(transparent)]
    Dataset(#[from] DataError),
    /// A checkpoint to start from.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Its weights.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// The model directory.
    #[error(transparent)]
    Export(#[from] ExportError),
}

impl TrainError {
    pub(super) fn file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }

    pub(super) fn state(path: &Path) -> impl FnOnce(String) -> Self {
        let path = path.to_owned();
        move |message| Self::State { path, message }
    }
}
