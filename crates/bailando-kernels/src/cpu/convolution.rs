//! Convolutions: every group of pieces is lowered and multiplied on its own, by one thread.

use burn_flex::Flex;
use burn_tensor::Tensor;
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, Slice, linalg::general_mat_mul};
use rayon::prelude::*;

use super::memory::{add, host, tensor, values};
use crate::{Affine, Convolution, lowering::Product};

/// Rows of a matrix product that one thread takes at a time: large enough that a product is worth
/// its preparation, small enough that its operands stay in a core's own cache.
const GROUP_ROWS: usize = 240;

pub(super) fn convolve(
    plan: Convolution,
    Affine { input, weight, bias }: Affine<Flex>,
) -> Tensor<Flex, 3> {
    let [batch, time, _] = input.dims();
    let (input, weight, bias) = (host(input), host(weight), host(bias));
    let grouped = Grouped::new(plan, time, values(&weight));
    let mut output = vec![0.0; batch * grouped.output_length()];
    output
        .par_chunks_mut((grouped.group() * grouped.output_length()).max(1))
        .zip(values(&input).par_chunks((grouped.group() * grouped.input_length()).max(1)))
        .for_each(|(output, input)| grouped.forward(input, values(&bias), output));
    let frames = plan.rows(time) * plan.outputs_per_row();
    tensor(output, [batch, frames, plan.outputs])
}

pub(super) fn convolve_backward(
    plan: Convolution,
    Affine { input, weight, .. }: Affine<Flex>,
    outer: Tensor<Flex, 3>,
) -> Affine<Flex> {
    let shape = input.dims();
    let [_, time, _] = shape;
    let (input, weight, outer) = (host(input), host(weight), host(outer));
    let grouped = Grouped::new(plan, time, values(&weight));
    let mut by_input = vec![0.0; values(&input).len()];
    let group = grouped.group();
    let changes: Vec<Changes> = by_input
        .par_chunks_mut((group * grouped.input_length()).max(1))
        .zip(values(&input).par_chunks((group * grouped.input_length()).max(1)))
        .zip(values(&outer).par_chunks((group * grouped.output_length()).max(1)))
        .map(|((by_input, input), outer)| grouped.backward(input, outer, by_input))
        .collect();
    let mut weight_change = vec![0.0; values(&weight).len()];
    let mut bias_change = vec![0.0; plan.outputs];
    for change in &changes {
        for (products, change) in grouped.products.iter().zip(&change.kernels) {
            products.add_to(change, &mut weight_change);
        }
        add(&mut bias_change, &change.bias);
    }
    let (weights, biases) = (weight_change.len(), bias_change.len());
    Affine {
        input: tensor(by_input, shape),
        weight: tensor(weight_change, [weights]),
        bias: tensor(bias_change, [biases]),
    }
}

/// Derivatives of one group.
struct Changes {
    /// One for each product.
    kernels: Vec<Array2<f32>>,
    bias: Vec<f32>,
}

/// A product with its part of the kernel, `[frames * in, out]`.
struct Prepared {
    product: Product,
    kernel: Array2<f32>,
    inputs: usize,
}

impl Prepared {
    fn columns(&self) -> Slice {
        let frames = &self.product.frames;
        Slice::from(frames.start * self.inputs..frames.end * self.inputs)
    }

    fn outputs(&self) -> Slice {
        let outputs = self.kernel.ncols();
        Slice::from(self.product.output * outputs..(self.product.output + 1) * outputs)
    }

    /// Adds the derivative of this part to that of the whole kernel.
    #[expect(clippy::expect_used, reason = "a fresh product is contiguous")]
    fn add_to(&self, change: &Array2<f32>, whole: &mut [f32]) {
        let length = self.inputs * self.kernel.ncols();
        let parts = change.as_slice().expect("a product is contiguous").chunks(length.max(1));
        for (&tap, part) in self.product.taps.iter().zip(parts) {
            let Some(slot) = whole.get_mut(tap * length..(tap + 1) * length) else {
                continue;
            };
            add(slot, part);
        }
    }
}

/// A convolution of pieces of one length.
struct Grouped {
    plan: Convolution,
    time: usize,
    rows: usize,
    products: Vec<Prepared>,
}

impl Grouped {
    fn new(plan: Convolution, time: usize, weight: &[f32]) -> Self {
        let length = plan.inputs * plan.outputs;
        let products = plan.products().into_iter().map(|product| {
            let taps = product.taps.iter();
            let kernel: Vec<f32> = taps
                .flat_map(|tap| weight.get(tap * length..(tap + 1) * length).unwrap_or(&[]))
                .copied()
                .collect();
            let mut kernel = kernel.into_iter();
            let shape = (product.frames.len() * plan.inputs, plan.outputs);
            Prepared {
                kernel: Array2::from_shape_simple_fn(shape, || kernel.next().unwrap_or(0.0)),
                product,
                inputs: plan.inputs,
            }
        });
        Self { plan, time, rows: plan.rows(time), products: products.collect() }
    }

    /// Pieces of a group.
    fn group(&self) -> usize {
        GROUP_ROWS.div_ceil(self.rows.max(1))
    }

    fn input_length(&self) -> usize {
        self.time * self.plan.inputs
    }

    fn output_width(&self) -> usize {
        self.plan.outputs_per_row() * self.plan.outputs
    }

    fn output_length(&self) -> usize {
        self.rows * self.output_width()
    }

    fn width(&self) -> usize {
        self.plan.frames() * self.plan.inputs
    }

    fn forward(&self, input: &[f32], bias: &[f32], output: &mut [f32]) {
        let lowered = self.lower(input);
        for row in output.chunks_exact_mut(bias.len().max(1)) {
            row.copy_from_slice(bias);
        }
        let output = matrix_mut(output, self.output_width());
        let (Some(lowered), Some(mut output)) = (matrix(&lowered, self.width()), output) else {
            return;
        };
        for prepared in &self.products {
            let columns = lowered.slice_axis(Axis(1), prepared.columns());
            let mut output = output.slice_axis_mut(Axis(1), prepared.outputs());
            general_mat_mul(1.0, &columns, &prepared.kernel, 1.0, &mut output);
        }
    }

    fn backward(&self, input: &[f32], outer: &[f32], by_input: &mut [f32]) -> Changes {
        let lowered = self.lower(input);
        let mut by_lowered = vec![0.0; lowered.len()];
        let mut bias = vec![0.0; self.plan.outputs];
        for row in outer.chunks_exact(bias.len().max(1)) {
            add(&mut bias, row);
        }
        let mut kernels = Vec::with_capacity(self.products.len());
        if let (Some(outer), Some(lowered), Some(mut by_lowered)) = (
            matrix(outer, self.output_width()),
            matrix(&lowered, self.width()),
            matrix_mut(&mut by_lowered, self.width()),
        ) {
            for prepared in &self.products {
                let outer = outer.slice_axis(Axis(1), prepared.outputs());
                let columns = lowered.slice_axis(Axis(1), prepared.columns());
                kernels.push(columns.t().dot(&outer));
                let mut change = by_lowered.slice_axis_mut(Axis(1), prepared.columns());
                general_mat_mul(1.0, &outer, &prepared.kernel.t(), 1.0, &mut change);
            }
        }
        self.raise(&by_lowered, input, by_input);
        Changes { kernels, bias }
    }

    /// Frames side by side, `[pieces * rows, frames * in]`.
    fn lower(&self, input: &[f32]) -> Vec<f32> {
        let channels = self.plan.inputs;
        let width = self.width();
        let pieces = input.len() / self.input_length().max(1);
        let mut lowered = Vec::with_capacity(pieces * self.rows * width);
        for piece in input.chunks_exact(self.input_length().max(1)) {
            for row in 0..self.rows {
                for frame in 0..self.plan.frames() {
                    let source = self.plan.source(row, frame, self.time);
                    let source =
                        source.and_then(|at| piece.get(at * channels..(at + 1) * channels));
                    match source {
                        None => lowered.resize(lowered.len() + channels, 0.0),
                        Some(values) if self.plan.rectified => {
                            lowered.extend(values.iter().map(|value| value.max(0.0)));
                        }
                        Some(values) => lowered.extend_from_slice(values),
                    }
                }
            }
        }
        lowered
    }

    /// The transpose of [`Grouped::lower`], and of the rectifier.
    fn raise(&self, rows: &[f32], input: &[f32], raised: &mut [f32]) {
        let channels = self.plan.inputs;
        let length = self.input_length().max(1);
        let width = self.width().max(1);
        let pieces = rows.chunks_exact((self.rows * width).max(1));
        for (piece, rows) in raised.chunks_exact_mut(length).zip(pieces) {
            for (row, values) in rows.chunks_exact(width).enumerate() {
                for (frame, values) in values.chunks_exact(channels.max(1)).enumerate() {
                    let target = self.plan.source(row, frame, self.time);
                    let target =
                        target.and_then(|at| piece.get_mut(at * channels..(at + 1) * channels));
                    for (sum, value) in target.into_iter().flatten().zip(values) {
                        *sum += value;
                    }
                }
            }
        }
        if self.plan.rectified {
            for (value, input) in raised.iter_mut().zip(input) {
                *value = if *input > 0.0 { *value } else { 0.0 };
            }
        }
    }
}

fn matrix(values: &[f32], width: usize) -> Option<ArrayView2<'_, f32>> {
    ArrayView2::from_shape((values.len() / width.max(1), width), values).ok()
}

fn matrix_mut(values: &mut [f32], width: usize) -> Option<ArrayViewMut2<'_, f32>> {
    ArrayViewMut2::from_shape((values.len() / width.max(1), width), values).ok()
}
