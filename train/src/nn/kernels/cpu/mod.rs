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
use burn_tensor::{Bool, Tensor};

use super::{AffineGradients, AttentionGradients, Convolution, Descent, Heads, Kernels, Queries};

impl Kernels for Flex {
    fn convolve(
        plan: Convolution,
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        bias: Tensor<Self, 1>,
    ) -> Tensor<Self, 3> {
        if plan.is_linear() {
            return linear::map(plan, input, weight, bias);
        }
        convolution::convolve(plan, input, weight, bias)
    }

    fn convolve_backward(
        plan: Convolution,
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        outer: Tensor<Self, 3>,
    ) -> AffineGradients<Self> {
        if plan.is_linear() {
            return linear::map_backward(plan, input, weight, outer);
        }
        convolution::convolve_backward(plan, input, weight, outer)
    }

    fn activate(input: Tensor<Self, 3>) -> Tensor<Self, 3> {
        elementwise::gelu(input)
    }

    fn activate_backward(input: Tensor<Self, 3>, outer: Tensor<Self, 3>) -> Tensor<Self, 3> {
        elementwise::gelu_backward(input, outer)
    }

    fn normalise(
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        bias: Tensor<Self, 1>,
    ) -> Tensor<Self, 3> {
        elementwise::normalise(input, weight, bias)
    }

    fn normalise_backward(
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        outer: Tensor<Self, 3>,
    ) -> AffineGradients<Self> {
        elementwise::normalise_backward(input, weight, outer)
    }

    fn attend(
        heads: Heads,
        queries: Queries<Self>,
        forbidden: Tensor<Self, 2, Bool>,
        kept: Option<Tensor<Self, 4>>,
    ) -> Tensor<Self, 3> {
        attention::attend(heads, queries, forbidden, kept)
    }

    fn attend_backward(
        heads: Heads,
        queries: Queries<Self>,
        forbidden: Tensor<Self, 2, Bool>,
        kept: Option<Tensor<Self, 4>>,
        outer: Tensor<Self, 3>,
    ) -> AttentionGradients<Self> {
        attention::attend_backward(heads, queries, forbidden, kept, outer)
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
