//! What the operations take and give, beside tensors.

use burn_tensor::{Bool, Tensor, backend::Backend};

/// Keeps a normalisation from dividing by zero.
pub(crate) const NORM_EPSILON: f64 = 1e-5;

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

/// What attention takes.
#[derive(Clone, Debug)]
pub struct AttentionInputs<B: Backend> {
    /// Heads that share the channels, one after the other.
    pub heads: usize,
    /// Queries, keys and values.
    pub queries: Queries<B>,
    /// `[length, length]`, true where a query must not see a key.
    pub forbidden: Tensor<B, 2, Bool>,
    /// `[batch, heads, length, length]`: factors of the shares, where some are dropped.
    pub kept: Option<Tensor<B, 4>>,
}

/// Queries, keys and values, or the derivatives by them; `[batch, length, channels]` each.
#[derive(Clone, Debug)]
#[expect(missing_docs, reason = "the names are the usual ones")]
pub struct Queries<B: Backend> {
    pub query: Tensor<B, 3>,
    pub key: Tensor<B, 3>,
    pub value: Tensor<B, 3>,
}

/// What a convolution or normalisation takes, or the derivatives by it.
#[derive(Clone, Debug)]
pub struct Affine<B: Backend> {
    /// `[batch, length, channels]`.
    pub input: Tensor<B, 3>,
    /// Flat.
    pub weight: Tensor<B, 1>,
    /// `[channels of the result]`.
    pub bias: Tensor<B, 1>,
}
