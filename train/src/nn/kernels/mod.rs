//! What most of the training time goes into, with derivatives written by hand.
//!
//! Every backend can do it with its own tensor operations ([`Kernels`]'s defaults); the CPU has
//! faster ones of its own ([`cpu`]). [`derivative`] makes both known to automatic derivatives.

mod cpu;
mod derivative;
mod lowering;
mod plain;

pub use lowering::{Convolution, Kind};

use burn_tensor::{
    Tensor as Device,
    backend::{AutodiffBackend, Backend},
};

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
