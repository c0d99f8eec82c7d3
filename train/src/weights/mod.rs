//! The networks' weights with their roles: read from checkpoints, written into graphs and
//! read from these. All sizes
//! are read off the tensors' shapes and checked against each other.

mod encoder_graph;
mod gpt;
mod graphs;
mod source;
mod vqvae;

pub(crate) use encoder_graph::encoders_from_graph;
pub(crate) use source::Tensors;

pub use gpt::{Block, CriticWeights, GptWeights, LayerNorm, Linear};
pub use graphs::MotionWeights;
pub use vqvae::{
    Convolution, DecoderLevel, DecoderWeights, EncoderLevel, EncoderWeights, HALF_JOINTS,
    HalfWeights, ResidualBlock, VqVaeWeights,
};

use std::path::PathBuf;

use crate::checkpoint::CheckpointError;

/// Why weights could not be taken from a checkpoint.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages are the documentation")]
pub enum WeightError {
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error("{}: {channels} channels cannot be divided among {heads} heads: give the right count \
             with --heads", path.display())]
    Heads { path: PathBuf, channels: usize, heads: usize },
}
