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
pub enum TrainError {
    /// A file or folder could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A configuration that cannot be used.
    #[error("{}: {message}", path.display())]
    Config {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        message: String,
    },
    /// A data folder that cannot be used.
    #[error("{}: {message}", path.display())]
    Data {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        message: String,
    },
    /// No piece of the training split is long enough.
    #[error("no training piece is long enough for a window of {length} {unit}")]
    TooShort {
        /// Length of a window.
        length: usize,
        /// Of what.
        unit: &'static str,
    },
    /// A checkpoint of ours that cannot be used.
    #[error("{}: {message}", path.display())]
    State {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        message: String,
    },
    /// Two processes would write each other's checkpoints.
    #[error("{}: another process is training there", folder.display())]
    Busy {
        /// The stage's folder.
        folder: PathBuf,
    },
    /// A stage that has to come before is not finished.
    #[error("{} is missing or not finished: run `bailando-train {stage}` first", path.display())]
    StageMissing {
        /// The stage.
        stage: &'static str,
        /// Its checkpoint.
        path: PathBuf,
    },
    /// Something that a model with parts left out does not have.
    #[error("{what}: not with ablation.{flag} (generate its motion: `bailando-train generate`)")]
    LeftOut {
        /// What was asked for.
        what: &'static str,
        /// The setting.
        flag: &'static str,
    },
    /// A loss is no number.
    #[error(
        "the {column} of {stage} is {value} around step {step}: the run stops here, and the last \
         checkpoint is from before (lower the rate, or set clip)"
    )]
    NotFinite {
        /// The stage.
        stage: &'static str,
        /// Which value.
        column: &'static str,
        /// What it is.
        value: f32,
        /// The last step it covers.
        step: u64,
    },
    /// A device that is not there.
    #[error("device `{device}`: {message}")]
    Device {
        /// As asked for.
        device: String,
        /// Why not.
        message: String,
    },
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
