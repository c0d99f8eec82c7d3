//! The kernels on a CPU.
//!
//! How work is divided among threads depends on its size alone, and parts are summed in order, so
//! results do not depend on the number of threads. Products in less than float32 are left to the
//! plain kernels: slower here, but what an accelerator computes.

mod attention;
mod convolution;
mod descent;
mod elementwise;
mod linear;

use burn_flex::{Flex, FlexTensor};
use burn_tensor::{Bool, Tensor as Device, TensorData, TensorPrimitive};

use super::{
    AttentionGradients, Convolution, ConvolutionGradients, Descent, Heads, Kernels, NormGradients,
    Precision, Queries, plain,
};

impl Kernels for Flex {
    fn convolve(
        plan: Convolution,
        input: Device<Self, 3>,
        weight: Device<Self, 1>,
        bias: Device<Self, 1>,
    ) -> Device<Self, 3> {
        if plan.precision != Precision::F32 {
            return plain::convolve(plan, input, weight, bias);
        }
        if plan.is_linear() {
            return linear::map(plan, input, weight, bias);
        }
        convolution::convolve(plan, input, weight, bias)
    }

    fn convolve_backward(
        plan: Convolution,
        input: Device<Self, 3>,
        weight: Device<Self, 1>,
        outer: Device<Self, 3>,
    ) -> ConvolutionGradients<Self> {
        if plan.precision != Precision::F32 {
            return plain::convolve_backward(plan, input, weight, outer);
        }
        if plan.is_linear() {
            return linear::map_backward(plan, input, weight, outer);
        }
        convolution::convolve_backward(plan, input, weight, outer)
    }

    fn activate(input: Device<Self, 3>) -> Device<Self, 3> {
        elementwise::gelu(input)
    }

    fn activate_backward(input: Device<Self, 3>, outer: Device<Self, 3>) -> Device<Self, 3> {
        elementwise::gelu_backward(input, outer)
    }

    fn normalise(
        input: Device<Self, 3>,
        weight: Device<Self, 1>,
        bias: Device<Self, 1>,
    ) -> Device<Self, 3> {
        elementwise::normalise(input, weight, bias)
    }

    fn normalise_backward(
        input: Device<Self, 3>,
        weight: Device<Self, 1>,
        outer: Device<Self, 3>,
    ) -> NormGradients<Self> {
        elementwise::normalise_backward(input, weight, outer)
    }

    fn attend(
        heads: Heads,
        queries: Queries<Self>,
        forbidden: Device<Self, 2, Bool>,
        kept: Option<Device<Self, 4>>,
    ) -> Device<Self, 3> {
        attention::attend(heads, queries, forbidden, kept)
    }

    fn attend_backward(
        heads: Heads,
        queries: Queries<Self>,
        forbidden: Device<Self, 2, Bool>,
        kept: Option<Device<Self, 4>>,
        outer: Device<Self, 3>,
    ) -> AttentionGradients<Self> {
        attention::attend_backward(heads, queries, forbidden, kept, outer)
    }

    fn descend(
        step: Descent,
        tensor: Device<Self, 1>,
        gradient: Device<Self, 1>,
        moments: [Device<Self, 1>; 2],
    ) -> (Device<Self, 1>, [Device<Self, 1>; 2]) {
        descent::descend(step, tensor, gradient, moments)
    }

    fn kept<const D: usize>(like: &Device<Self, D>, share: f64) -> Device<Self, D> {
        elementwise::kept(like, share)
    }
}

/// Adds values to sums, place by place.
fn add(sums: &mut [f32], values: &[f32]) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += value;
    }
}

/// The tensor with its values in order.
fn host<const D: usize>(tensor: Device<Flex, D>) -> FlexTensor {
    tensor.into_primitive().tensor().to_contiguous()
}

/// The values of a tensor from [`host`].
fn values(tensor: &FlexTensor) -> &[f32] {
    tensor.as_slice().unwrap_or_default()
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> Device<Flex, D> {
    let primitive = FlexTensor::from_data(TensorData::new(values, shape));
    Device::from_primitive(TensorPrimitive::Float(primitive))
}
