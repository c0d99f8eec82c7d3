//! What most of the training time goes into, with derivatives written by hand.
//!
//! Every backend can do it with its own tensor operations ([`Kernels`]'s defaults); the CPU has
//! faster ones of its own ([`cpu`]). [`derivative`] makes both known to automatic derivatives.

mod cpu;
mod derivative;
mod lowering;
mod plain;
#[cfg(test)]
mod tests;

pub use lowering::{Convolution, Kind, Precision};

use burn_tensor::{
    Bool, Tensor as Device,
    backend::{AutodiffBackend, Backend},
};

/// What keeps a normalisation from dividing by zero.
const NORM_EPSILON: f64 = 1e-5;

/// A backend with the operations of this module.
pub trait Kernels: Backend {
    /// Convolution along time: `input` `[batch, time, in]`, `weight` `[kernel * in * out]` (kernel
    /// first), `bias` `[out]`; gives `[batch, time', out]`.
    fn convolve(
        plan: Convolution,
        input: Device<Self, 3>,
        weight: Device<Self, 1>,
        bias: Device<Self, 1>,
    ) -> Device<Self, 3> {
        plain::convolve(plan, input, weight, bias)
    }

    /// The derivative of [`Kernels::convolve`] for the derivative `outer` of its result.
    fn convolve_backward(
        plan: Convolution,
        input: Device<Self, 3>,
        weight: Device<Self, 1>,
        outer: Device<Self, 3>,
    ) -> ConvolutionGradients<Self> {
        plain::convolve_backward(plan, input, weight, outer)
    }

    /// GELU: `x` times the share of a normal distribution below it.
    fn activate(input: Device<Self, 3>) -> Device<Self, 3> {
        burn_tensor::activation::gelu(input)
    }

    /// The derivative of [`Kernels::activate`].
    fn activate_backward(input: Device<Self, 3>, outer: Device<Self, 3>) -> Device<Self, 3> {
        plain::gelu_backward(input, outer)
    }

    /// Each row of `input` `[batch, length, channels]` to mean 0 and spread 1, then times `weight`
    /// plus `bias` `[channels]`.
    fn normalise(
        input: Device<Self, 3>,
        weight: Device<Self, 1>,
        bias: Device<Self, 1>,
    ) -> Device<Self, 3> {
        plain::normalise(input, weight, bias)
    }

    /// The derivative of [`Kernels::normalise`].
    fn normalise_backward(
        input: Device<Self, 3>,
        weight: Device<Self, 1>,
        outer: Device<Self, 3>,
    ) -> NormGradients<Self> {
        plain::normalise_backward(input, weight, outer)
    }

    /// Attention of every head, `[batch, length, channels]`. `forbidden` `[length, length]` is true
    /// where a query must not see a key; `kept` `[batch, heads, length, length]` are factors of the
    /// shares where some are dropped.
    fn attend(
        heads: Heads,
        queries: Queries<Self>,
        forbidden: Device<Self, 2, Bool>,
        kept: Option<Device<Self, 4>>,
    ) -> Device<Self, 3> {
        plain::attend(heads, queries, forbidden, kept)
    }

    /// The derivative of [`Kernels::attend`].
    fn attend_backward(
        heads: Heads,
        queries: Queries<Self>,
        forbidden: Device<Self, 2, Bool>,
        kept: Option<Device<Self, 4>>,
        outer: Device<Self, 3>,
    ) -> AttentionGradients<Self> {
        plain::attend_backward(heads, queries, forbidden, kept, outer)
    }

    /// One step of Adam: the tensor and its two moments afterwards.
    fn descend(
        step: Descent,
        tensor: Device<Self, 1>,
        gradient: Device<Self, 1>,
        moments: [Device<Self, 1>; 2],
    ) -> (Device<Self, 1>, [Device<Self, 1>; 2]) {
        plain::descend(step, tensor, gradient, moments)
    }

    /// Random factors in the shape of `like`: 0 for that share of the values, else what keeps the
    /// mean.
    fn kept<const D: usize>(like: &Device<Self, D>, share: f64) -> Device<Self, D> {
        plain::kept(like, share)
    }
}

/// What a step of Adam does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Descent {
    /// What is kept of the moments.
    pub betas: [f64; 2],
    /// What the moments are divided by, for they started from zero.
    pub corrections: [f64; 2],
    /// How far the step goes.
    pub rate: f64,
    /// What keeps it from dividing by zero.
    pub epsilon: f64,
}

/// Attention heads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heads {
    /// How many share the channels.
    pub count: usize,
}

/// What attention is computed from, `[batch, length, channels]` each, the heads' channels one after
/// the other.
#[derive(Clone, Debug)]
#[expect(missing_docs, reason = "the names are the usual ones")]
pub struct Queries<B: Backend> {
    pub query: Device<B, 3>,
    pub key: Device<B, 3>,
    pub value: Device<B, 3>,
}

/// Derivatives by what went into attention.
pub type AttentionGradients<B> = Queries<B>;

/// Derivatives by what went into a normalisation, in the same shapes.
#[derive(Clone, Debug)]
pub struct NormGradients<B: Backend> {
    /// By the input.
    pub input: Device<B, 3>,
    /// By the weight.
    pub weight: Device<B, 1>,
    /// By the bias.
    pub bias: Device<B, 1>,
}

/// Derivatives by what went into a convolution, in the same shapes.
#[derive(Clone, Debug)]
pub struct ConvolutionGradients<B: Backend> {
    /// By the input.
    pub input: Device<B, 3>,
    /// By the weight.
    pub weight: Device<B, 1>,
    /// By the bias.
    pub bias: Device<B, 1>,
}

/// A backend that networks are trained on.
pub trait Trainable: AutodiffBackend<InnerBackend: Kernels> + Kernels {}

impl<A: AutodiffBackend<InnerBackend: Kernels> + Kernels> Trainable for A {}

#[cfg(feature = "cuda")]
impl Kernels for burn_cuda::Cuda {}

#[cfg(feature = "libtorch")]
impl Kernels for burn_tch::LibTorch {}

#[cfg(feature = "wgpu")]
impl Kernels for burn_wgpu::Wgpu {}
