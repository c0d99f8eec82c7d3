//! The networks as they are trained, generic over the backend.
//!
//! A network is a plan: sizes, and places in a list of [`Parameters`]. The same plan runs on
//! tensors with derivatives (training) and without them (testing, frozen parts). Weights come in
//! and go out as the structs of [`crate::weights`], so random starts, official checkpoints and
//! exports share one path.

mod codebook;
mod convolution;
mod critic;
mod gpt;
mod host;
mod initial;
mod parameters;
mod range_observer;
mod transformer;
mod vqvae;

pub(crate) use bailando_kernels::{Descent, Kernels, Trainable};
pub use codebook::{Codebook, MovingAverage};
pub use critic::CriticNet;
pub use gpt::{GptNet, KvCache, Logits};
pub(crate) use host::{codes, gathered, numbers, values};
pub use initial::{GptSizes, VqVaeSizes, random_critic, random_gpt, random_vqvae};
pub use parameters::{Parameters, Store};
pub use vqvae::{DecoderNet, EncoderNet, HalfNet};
