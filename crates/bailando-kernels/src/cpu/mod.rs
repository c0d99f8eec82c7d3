//! The kernels on a CPU.
//!
//! How work is divided among threads depends on its size alone, and parts are summed in order, so
//! results do not depend on the number of threads.

mod attention;
mod convolution;
mod descent;
mod elementwise;
mod linear;
mod memory;

use burn_flex::Flex;
use burn_tensor::Tensor;

use crate::{Affine, AttentionInputs, Convolution, Descent, Kernels, Queries};

impl Kernels for Flex {
    fn convolve(plan: Convolution, affine: Affine<Self>) -> Tensor<Self, 3> {
        if plan.is_linear() {
            return linear::map(plan, affine);
        }
        convolution::convolve(plan, affine)
    }

    fn convolve_backward(
        plan: Convolution,
        affine: Affine<Self>,
        outer: Tensor<Self, 3>,
    ) -> Affine<Self> {
        if plan.is_linear() {
            return linear::map_backward(plan, affine, outer);
        }
        convolution::convolve_backward(plan, affine, outer)
    }

    fn activate(input: Tensor<Self, 3>) -> Tensor<Self, 3> {
        elementwise::gelu(input)
    }

    fn activate_backward(input: Tensor<Self, 3>, outer: Tensor<Self, 3>) -> Tensor<Self, 3> {
        elementwise::gelu_backward(input, outer)
    }

    fn normalise(affine: Affine<Self>) -> Tensor<Self, 3> {
        elementwise::normalise(affine)
    }

    fn normalise_backward(affine: Affine<Self>, outer: Tensor<Self, 3>) -> Affine<Self> {
        elementwise::normalise_backward(affine, outer)
    }

    fn attend(inputs: AttentionInputs<Self>) -> Tensor<Self, 3> {
        attention::attend(inputs)
    }

    fn attend_backward(inputs: AttentionInputs<Self>, outer: Tensor<Self, 3>) -> Queries<Self> {
        attention::attend_backward(inputs, outer)
    }

    fn descend(
        step: Descent,
        tensor: Tensor<Self, 1>,
        gradient: Tensor<Self, 1>,
        moments: [Tensor<Self, 1>; 2],
    ) -> (Tensor<Self, 1>, [Tensor<Self, 1>; 2]) {
        descent::descend(step, tensor, gradient, moments)
    }

    fn kept<const D: usize>(like: &Tensor<Self, D>, share: f64) -> Tensor<Self, D> {
        elementwise::kept(like, share)
    }
}
