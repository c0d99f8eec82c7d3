//! Why a model directory could not be written.

use std::path::PathBuf;

use bailando::{model::ModelError, motion::MotionFrame};

use crate::onnx::GraphError;

/// Why a model directory could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each message names its fields")]
pub enum ExportError {
    /// The GPT and the VQ-VAE do not belong together.
    #[error(
        "the GPT has {gpt} {half} codes, but the VQ-VAE's codebook has {codebook}: are they of the \
         same model?"
    )]
    Vocabulary { half: &'static str, gpt: usize, codebook: usize },
    /// The root's decoder is not one of the frame that the motion is said to be in.
    #[error(
        "the root's decoder gives {found} columns, but motion in the {} frame has {expected}: is \
         the frame right?",
        match frame { MotionFrame::World => "world's", MotionFrame::Dancer => "dancer's" }
    )]
    Frame { frame: MotionFrame, expected: usize, found: usize },
    /// A graph could not be built.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The manifest could not be written as JSON.
    #[error("manifest.json: {0}")]
    Manifest(serde_json::Error),
    /// The directory is already there.
    #[error("{} is already there: choose another directory, or replace the model in it with \
             --force", .0.display())]
    Exists(PathBuf),
    /// The directory is no model's and will not be replaced.
    #[error("{} holds something that is not a model directory: it will not be \
             replaced", .0.display())]
    NotAModel(PathBuf),
    /// The path does not end in a name.
    #[error("{} is not a place for a new directory", .0.display())]
    NoName(PathBuf),
    /// A file or directory could not be written.
    #[error("{}: {source}", path.display())]
    Write { path: PathBuf, source: std::io::Error },
    /// What was written cannot be loaded.
    #[error("the written model cannot be loaded: {0}")]
    Load(#[from] ModelError),
}
