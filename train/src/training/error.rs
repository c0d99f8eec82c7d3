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
#[expect(missing_docs, reason = "the messages are the documentation")]
pub enum TrainError {
    #[error("{}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    #[error("{}: {message}", path.display())]
    Config { path: PathBuf, message: String },
    #[error("{}: {message}", path.display())]
    Data { path: PathBuf, message: String },
    #[error("no training piece is long enough for a window of {length} {unit}")]
    TooShort { length: usize, unit: &'static str },
    #[error("{}: {message}", path.display())]
    State { path: PathBuf, message: String },
    #[error("{}: another process is training there", folder.display())]
    Busy { folder: PathBuf },
    #[error("{} is missing or not finished: run `bailando-train {stage}` first", path.display())]
    StageMissing { stage: &'static str, path: PathBuf },
    #[error("{what}: not with ablation.{flag} (generate its motion: `bailando-train generate`)")]
    LeftOut { what: &'static str, flag: &'static str },
    #[error(
        "the {column} of {stage} is {value} around step {step}: the run stops here, and the last \
         checkpoint is from before (lower the rate, or set clip)"
    )]
    NotFinite { stage: &'static str, column: &'static str, value: f32, step: u64 },
    #[error("device `{device}`: {message}")]
    Device { device: String, message: String },
    #[error(transparent)]
    Dataset(#[from] DataError),
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    Weights(#[from] WeightError),
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
