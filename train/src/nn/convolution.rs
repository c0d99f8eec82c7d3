//! Convolutions along time and residual blocks of them, channels last.

use bailando_kernels::{Convolution as Plan, Kernels, Kind};
use burn_tensor::Tensor;

use super::parameters::{Parameters, Slot, Store};
use crate::{HostTensor, weights::Convolution};

#[derive(Clone, Debug)]
pub(super) struct ConvolutionNet {
    plan: Plan,
    /// `[kernel, in, out]`.
    weight: Slot,
    /// `[out]`.
    bias: Slot,
}

impl ConvolutionNet {
    pub(super) fn new(name: &str, kind: Kind, weights: &Convolution, store: &mut Store) -> Self {
        let tensor = match kind {
            Kind::Doubling => permuted(&weights.weight, [2, 0, 1]),
            _ => permuted(&weights.weight, [2, 1, 0]),
        };
        Self {
            plan: Plan { kind, rectified: false, inputs: tensor.dim(1), outputs: tensor.dim(2) },
            weight: store.push(format!("{name}.weight"), tensor),
            bias: store.push(format!("{name}.bias"), weights.bias.clone()),
        }
    }

    pub(super) fn weights(&self, store: &Store) -> Convolution {
        let weight = store.get(self.weight);
        Convolution {
            weight: match self.plan.kind {
                Kind::Doubling => permuted(weight, [1, 2, 0]),
                _ => permuted(weight, [2, 1, 0]),
            },
            bias: store.get(self.bias).clone(),
        }
    }

    /// `[batch, time, in]` to `[batch, time', out]`; time is even where it is halved.
    pub(super) fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Tensor<B, 3>,
    ) -> Tensor<B, 3> {
        B::convolve(self.plan, parameters.affine(input, self.weight, self.bias))
    }

    /// Runs the convolution on `relu(input)`.
    fn forward_rectified<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Tensor<B, 3>,
    ) -> Tensor<B, 3> {
        let plan = Plan { rectified: true, ..self.plan };
        B::convolve(plan, parameters.affine(input, self.weight, self.bias))
    }
}

/// `x + pointwise(relu(dilated(relu(x))))`.
#[derive(Clone, Debug)]
pub(super) struct ResidualNet {
    pub(super) dilated: ConvolutionNet,
    pub(super) pointwise: ConvolutionNet,
    pub(super) dilation: usize,
}

impl ResidualNet {
    pub(super) fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Tensor<B, 3>,
    ) -> Tensor<B, 3> {
        let wide = self.dilated.forward_rectified(parameters, input.clone());
        input + self.pointwise.forward_rectified(parameters, wide)
    }
}

/// Returns the tensor whose dimension `i` is dimension `axes[i]` of `tensor`.
fn permuted(tensor: &HostTensor, axes: [usize; 3]) -> HostTensor {
    let strides = [tensor.dim(1) * tensor.dim(2), tensor.dim(2), 1];
    let shape = axes.map(|axis| tensor.dim(axis));
    let strides = axes.map(|axis| strides[axis]);
    let [_, rows, columns] = shape;
    HostTensor::from_fn(shape.to_vec(), |flat| {
        let index = [flat / (rows * columns), flat / columns % rows, flat % columns];
        let place: usize = index.iter().zip(strides).map(|(i, s)| i * s).sum();
        tensor.data()[place]
    })
}
