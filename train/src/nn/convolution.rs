//! Convolutions along time as matrix products over shifted slices, channels last.
//!
//! One product of `[batch * time, kernel * in]` with `[kernel * in, out]` is faster than the
//! backends' own convolutions on a CPU (docs/training.md), and its derivative is two products.

use burn_tensor::{Tensor as Device, activation::relu, backend::Backend};

use super::parameters::{Parameters, Slot, Store};
use crate::{Tensor, weights::Convolution};

/// How a convolution moves along time (ARCHITECTURE section 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Kernel 3 with this dilation and padding.
    Dilated(usize),
    /// Kernel 1.
    Pointwise,
    /// Kernel 4, stride 2, padding 1.
    Halving,
    /// The transpose of that.
    Doubling,
}

#[derive(Clone, Debug)]
pub(super) struct ConvolutionNet {
    kind: Kind,
    /// `[kernel, in, out]`.
    weight: Slot,
    /// `[out]`.
    bias: Slot,
    outputs: usize,
}

impl ConvolutionNet {
    pub(super) fn new(name: &str, kind: Kind, weights: &Convolution, store: &mut Store) -> Self {
        let tensor = match kind {
            Kind::Doubling => permuted(&weights.weight, [2, 0, 1]),
            _ => permuted(&weights.weight, [2, 1, 0]),
        };
        Self {
            kind,
            outputs: weights.bias.dim(0),
            weight: store.push(format!("{name}.weight"), tensor),
            bias: store.push(format!("{name}.bias"), weights.bias.clone()),
        }
    }

    pub(super) fn weights(&self, store: &Store) -> Convolution {
        let weight = store.get(self.weight);
        Convolution {
            weight: match self.kind {
                Kind::Doubling => permuted(weight, [1, 2, 0]),
                _ => permuted(weight, [2, 1, 0]),
            },
            bias: store.get(self.bias).clone(),
        }
    }

    /// `[batch, time, in]` to `[batch, time', out]`; time is even where it is halved.
    pub(super) fn forward<B: Backend>(
        &self,
        parameters: &Parameters<B>,
        input: Device<B, 3>,
    ) -> Device<B, 3> {
        let [batch, time, channels] = input.dims();
        match self.kind {
            Kind::Pointwise => self.product(parameters, input),
            Kind::Dilated(dilation) => {
                let padded = padded(input, dilation);
                let slices = (0..3).map(|tap| padded.clone().narrow(1, tap * dilation, time));
                self.product(parameters, Device::cat(slices.collect(), 2))
            }
            Kind::Halving => {
                // Two neighbouring frames side by side: a kernel of 4 is a kernel of 2 over pairs.
                let pairs = padded(input, 1).reshape([batch, time / 2 + 1, 2 * channels]);
                let slices = (0..2).map(|tap| pairs.clone().narrow(1, tap, time / 2));
                self.product(parameters, Device::cat(slices.collect(), 2))
            }
            Kind::Doubling => self.doubled(parameters, input),
        }
    }

    fn product<B: Backend>(&self, parameters: &Parameters<B>, input: Device<B, 3>) -> Device<B, 3> {
        let [batch, time, columns] = input.dims();
        let rows = input.reshape([batch * time, columns]);
        let result = rows.matmul(parameters.matrix(self.weight)) + parameters.row(self.bias);
        result.reshape([batch, time, self.outputs])
    }

    /// Output `2i` is tap 3 of frame `i - 1` and tap 1 of frame `i`; output `2i + 1` is tap 2 of
    /// frame `i` and tap 0 of frame `i + 1`.
    fn doubled<B: Backend>(&self, parameters: &Parameters<B>, input: Device<B, 3>) -> Device<B, 3> {
        let [batch, time, channels] = input.dims();
        let outputs = self.outputs;
        let weight: Device<B, 3> = parameters.get(self.weight);
        let taps = |first: usize, second: usize| {
            let tap = |index| weight.clone().narrow(0, index, 1);
            Device::cat(vec![tap(first), tap(second)], 1).reshape([2 * channels, outputs])
        };
        let padded = padded(input, 1);
        let pairs = |from: usize| {
            let slice = |start| padded.clone().narrow(1, start, time);
            Device::cat(vec![slice(from), slice(from + 1)], 2).reshape([batch * time, 2 * channels])
        };
        let even = pairs(0).matmul(taps(3, 1));
        let odd = pairs(1).matmul(taps(2, 0));
        let bias = parameters.row(self.bias).repeat_dim(1, 2);
        let both = Device::cat(vec![even, odd], 1) + bias;
        both.reshape([batch, 2 * time, outputs])
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
    pub(super) fn forward<B: Backend>(
        &self,
        parameters: &Parameters<B>,
        input: Device<B, 3>,
    ) -> Device<B, 3> {
        let wide = self.dilated.forward(parameters, relu(input.clone()));
        input + self.pointwise.forward(parameters, relu(wide))
    }
}

/// Zeros of `length` frames at both ends.
fn padded<B: Backend>(input: Device<B, 3>, length: usize) -> Device<B, 3> {
    let [batch, _, channels] = input.dims();
    let zeros = Device::zeros([batch, length, channels], &input.device());
    Device::cat(vec![zeros.clone(), input, zeros], 1)
}

/// The tensor whose dimension `i` is dimension `axes[i]` of `tensor`.
fn permuted(tensor: &Tensor, axes: [usize; 3]) -> Tensor {
    let strides = [tensor.dim(1) * tensor.dim(2), tensor.dim(2), 1];
    let shape = axes.map(|axis| tensor.dim(axis));
    let strides = axes.map(|axis| strides[axis]);
    let [_, rows, columns] = shape;
    Tensor::from_fn(shape.to_vec(), |flat| {
        let index = [
            flat / (rows * columns),
            flat / columns % rows,
            flat % columns,
        ];
        let place: usize = index.iter().zip(strides).map(|(i, s)| i * s).sum();
        tensor.data()[place]
    })
}
