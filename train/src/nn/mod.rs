//! The networks as they are trained, generic over the backend.
//!
//! A network is a plan: sizes, and places in a list of [`Parameters`]. The same plan runs on tensors
//! that record derivatives (training) and on those that do not (testing, frozen parts). Weights come
//! in and go out as the structs of [`crate::weights`], so random starts, official checkpoints and
//! exports share one path.

mod codebook;
mod convolution;
mod critic;
mod gpt;
mod initial;
mod kernels;
mod parameters;
mod transformer;
mod vqvae;
mod watch;

pub use codebook::{Codebook, MovingAverage};
pub use critic::CriticNet;
pub use gpt::{GptNet, Logits, Memory};
pub use initial::{GptSizes, VqVaeSizes, random_critic, random_gpt, random_vqvae};
pub use kernels::{
    AttentionGradients, Convolution, ConvolutionGradients, Descent, Heads, Kernels, Kind,
    NormGradients, Precision, Queries, Trainable,
};
pub(crate) use parameters::values;
pub use parameters::{Parameters, Store};
pub use vqvae::{DecoderNet, EncoderNet, HalfNet};
