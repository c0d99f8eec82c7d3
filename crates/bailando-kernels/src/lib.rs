//! The operations that take most of the training time, with derivatives written by hand.
//!
//! Every backend has them in its own tensor operations ([`Kernels`]'s defaults); the CPU has faster
//! ones. Automatic derivatives know both.
//!
//! ```
//! use bailando_kernels::{Affine, Convolution, Kernels, Kind};
//! use burn_flex::{Flex, FlexDevice};
//! use burn_tensor::Tensor;
//!
//! let plan = Convolution { kind: Kind::Halving, rectified: false, inputs: 3, outputs: 5 };
//! let input = Tensor::<Flex, 3>::ones([2, 8, 3], &FlexDevice);
//! let weight = Tensor::ones([4 * 3 * 5], &FlexDevice);
//! let bias = Tensor::zeros([5], &FlexDevice);
//! let output = Flex::convolve(plan, Affine { input, weight, bias });
//! assert_eq!(output.dims(), [2, 4, 5]);
//! ```

mod cpu;
mod derivative;
mod lowering;
mod operands;
mod plain;
#[cfg(test)]
mod tests;

pub use lowering::{Convolution, Kind};
pub use operands::{Affine, AttentionInputs, Descent, Queries};

use burn_tensor::{
    Tensor,
    backend::{AutodiffBackend, Backend},
};

/// A backend with the operations of this crate.
pub trait Kernels: Backend {
    /// Convolution along time: `input` `[batch, time, in]`, `weight` `[kernel * in * out]` (kernel
    /// first), `bias` `[out]`; gives `[batch, time', out]`.
    fn convolve(plan: Convolution, affine: Affine<Self>) -> Tensor<Self, 3> {
        plain::convolve(plan, affine)
    }

    /// The derivative of [`Kernels::convolve`] for the derivative `outer` of its result.
    fn convolve_backward(
        plan: Convolution,
        affine: Affine<Self>,
        outer: Tensor<Self, 3>,
    ) -> Affine<Self> {
        plain::convolve_backward(plan, affine, outer)
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
    fn normalise(affine: Affine<Self>) -> Tensor<Self, 3> {
        plain::normalise(affine)
    }

    /// The derivative of [`Kernels::normalise`].
    fn normalise_backward(affine: Affine<Self>, outer: Tensor<Self, 3>) -> Affine<Self> {
        plain::normalise_backward(affine, outer)
    }

    /// Attention of every head, `[batch, length, channels]`.
    fn attend(inputs: AttentionInputs<Self>) -> Tensor<Self, 3> {
        plain::attend(inputs)
    }

    /// The derivative of [`Kernels::attend`].
    fn attend_backward(inputs: AttentionInputs<Self>, outer: Tensor<Self, 3>) -> Queries<Self> {
        plain::attend_backward(inputs, outer)
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
