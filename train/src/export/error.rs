//! Why a model directory could not be written.

use std::path::PathBuf;

use bailando::{model::ModelError, motion::MotionFrame};

use crate::onnx::GraphError;

/// Why a model directory could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages are the documentation")]
pub enum ExportError {
    #[error(
        "the GPT has {gpt} {half} codes, but the VQ-VAE's codebook has {codebook}: are they of the \
         same model?"
    )]
    Vocabulary { half: &'static str, gpt: usize, codebook: usize },
    #[error(
        "the root's decoder gives {found} columns, but motion in the {} frame has {expected}: is \
         the frame right?",
        match frame { MotionFrame::World => "world's", MotionFrame::Dancer => "dancer's" }
    )]
    Frame { frame: MotionFrame, expected: usize, found: usize },
    #[error(transparent)]
    Graph(#[from] GraphError),
    #[error("manifest.json: {0}")]
    Manifest(serde_json::Error),
    #[error("{} is already there: choose another directory, or replace the model in it with \
             --force", .0.display())]
    Exists(PathBuf),
    #[error("{} holds something that is not a model directory: it will not be \
             replaced", .0.display())]
    NotAModel(PathBuf),
    #[error("{} is not a place for a new directory", .0.display())]
    NoName(PathBuf),
    #[error("{}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{} has changed since the model was read: adapt it again", .0.display())]
    Changed(PathBuf),
    #[error("{}: {source}", path.display())]
    Write { path: PathBuf, source: std::io::Error },
    #[error("the written model cannot be loaded: {0}")]
    Load(#[from] ModelError),
}
