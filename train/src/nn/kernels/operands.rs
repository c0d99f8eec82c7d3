//! What the operations take and give, beside tensors.

use burn_tensor::{Tensor, backend::Backend};

/// Keeps a normalisation from dividing by zero.
pub(super) const NORM_EPSILON: f64 = 1e-5;

/// The numbers of a step of Adam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Descent {
    /// Share of the moments that a step keeps.
    pub betas: [f64; 2],
    /// Divisors of the moments, which started from zero.
    pub corrections: [f64; 2],
    /// Learning rate.
    pub rate: f64,
    /// Keeps the step from dividing by zero.
    pub epsilon: f64,
}

/// Attention heads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heads {
    /// How many share the channels.
    pub count: usize,
}

/// Inputs of attention, `[batch, length, channels]` each, the heads' channels one after
/// the other.
#[derive(Clone, Debug)]
#[expect(missing_docs, reason = "the names are the usual ones")]
pub struct Queries<B: Backend> {
    pub query: Tensor<B, 3>,
    pub key: Tensor<B, 3>,
    pub value: Tensor<B, 3>,
}

/// Derivatives by the inputs of attention.
pub type AttentionGradients<B> = Queries<B>;

/// Derivatives by the inputs of a convolution or normalisation, in the same shapes.
#[derive(Clone, Debug)]
pub struct AffineGradients<B: Backend> {
    /// By the input.
    pub input: Tensor<B, 3>,
    /// By the weight.
    pub weight: Tensor<B, 1>,
    /// By the bias.
    pub bias: Tensor<B, 1>,
}
