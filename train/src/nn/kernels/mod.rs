//! The operations that take most of the training time, with derivatives written by hand.
//!
//! Every backend has them in its own tensor operations ([`Kernels`]'s defaults); the CPU has faster
//! ones ([`cpu`]). [`derivative`] makes both known to automatic derivatives.

mod cpu;
mod derivative;
mod lowering;
mod operands;
mod plain;
#[cfg(test)]
mod tests;

pub use lowering::{Convolution, Kind};
pub use operands::{AffineGradients, AttentionGradients, Descent, Heads, Queries};

use burn_tensor::{
    Bool, Tensor,
    backend::{AutodiffBackend, Backend},
};

/// A backend with the operations of this module.
pub trait Kernels: Backend {
    /// Convolution along time: `input` `[batch, time, in]`, `weight` `[kernel * in * out]` (kernel
    /// first), `bias` `[out]`; gives `[batch, time', out]`.
    fn convolve(
        plan: Convolution,
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        bias: Tensor<Self, 1>,
    ) -> Tensor<Self, 3> {
        plain::convolve(plan, input, weight, bias)
    }

    /// The derivative of [`Kernels::convolve`] for the derivative `outer` of its result.
    fn convolve_backward(
        plan: Convolution,
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        outer: Tensor<Self, 3>,
    ) -> AffineGradients<Self> {
        plain::convolve_backward(plan, input, weight, outer)
    }

    /// GELU: `x` times the share of a normal distribution below it.
    fn activate(input: Tensor<Self, 3>) -> Tensor<Self, 3> {
        burn_tensor::activation::gelu(input)
    }

    /// The derivative of [`Kernels::activate`].
    fn activate_backward(input: Tensor<Self, 3>, outer: Tensor<Self, 3>) -> Tensor<Self, 3> {
        plain::gelu_backward(input, outer)
    }

    /// Each row of `input` `[batch, length, channels]` to mean 0 and spread 1, then times `weight`
    /// plus `bias` `[channels]`.
    fn normalise(
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        bias: Tensor<Self, 1>,
    ) -> Tensor<Self, 3> {
        plain::normalise(input, weight, bias)
    }

    /// The derivative of [`Kernels::normalise`].
    fn normalise_backward(
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        outer: Tensor<Self, 3>,
    ) -> AffineGradients<Self> {
        plain::normalise_backward(input, weight, outer)
    }

    /// Attention of every head, `[batch, length, channels]`. `forbidden` `[length, length]` is true
    /// where a query must not see a key; `kept` `[batch, heads, length, length]` are factors of the
    /// shares where some are dropped.
    fn attend(
        heads: Heads,
        queries: Queries<Self>,
        forbidden: Tensor<Self, 2, Bool>,
        kept: Option<Tensor<Self, 4>>,
    ) -> Tensor<Self, 3> {
        plain::attend(heads, queries, forbidden, kept)
    }

    /// The derivative of [`Kernels::attend`].
    fn attend_backward(
        heads: Heads,
        queries: Queries<Self>,
        forbidden: Tensor<Self, 2, Bool>,
        kept: Option<Tensor<Self, 4>>,
        outer: Tensor<Self, 3>,
    ) -> AttentionGradients<Self> {
        plain::attend_backward(heads, queries, forbidden, kept, outer)
    }

    /// One step of Adam: the tensor and its two moments afterwards.
    fn descend(
        step: Descent,
        tensor: Tensor<Self, 1>,
        gradient: Tensor<Self, 1>,
        moments: [Tensor<Self, 1>; 2],
    ) -> (Tensor<Self, 1>, [Tensor<Self, 1>; 2]) {
        plain::descend(step, tensor, gradient, moments)
    }

    /// Draws random factors in the shape of `like`: 0 for that share of the values; the others keep
    /// the mean.
    fn kept<const D: usize>(like: &Tensor<Self, D>, share: f64) -> Tensor<Self, D> {
        plain::kept(like, share)
    }
}

/// A backend that networks are trained on.
pub trait Trainable: AutodiffBackend<InnerBackend: Kernels> + Kernels {}

impl<A: AutodiffBackend<InnerBackend: Kernels> + Kernels> Trainable for A {}

#[cfg(feature = "libtorch")]
impl Kernels for burn_tch::LibTorch {}
