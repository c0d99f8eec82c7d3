//! The kernels in a backend's own tensor operations, derivatives by its own rules' formulas.

use burn_tensor::{
    Bool, Distribution, Tensor, TensorPrimitive,
    activation::{relu, softmax},
    backend::Backend,
};

use crate::{
    Affine, AttentionInputs, Convolution, Descent, Kind, Queries, lowering::Product,
    operands::NORM_EPSILON,
};

pub(super) fn convolve<B: Backend>(
    plan: Convolution,
    Affine { input, weight, bias }: Affine<B>,
) -> Tensor<B, 3> {
    let [batch, time, _] = input.dims();
    let outputs = plan.outputs;
    let lowered = lower(plan, input);
    let parts = plan.products().into_iter().map(|product| {
        let columns = columns(plan, &product, lowered.clone());
        columns.matmul(kernel_rows(plan, &product, weight.clone()))
    });
    let together = Tensor::cat(parts.collect(), 1);
    let frames = plan.rows(time) * plan.outputs_per_row();
    together.reshape([batch, frames, outputs]) + bias.reshape([1, 1, outputs])
}

pub(super) fn convolve_backward<B: Backend>(
    plan: Convolution,
    Affine { input, weight, .. }: Affine<B>,
    outer: Tensor<B, 3>,
) -> Affine<B> {
    let [batch, time, channels] = input.dims();
    let (rows, outputs) = (batch * plan.rows(time), plan.outputs);
    let device = input.device();
    let lowered = lower(plan, input.clone());
    let wide = outer.clone().reshape([rows, plan.outputs_per_row() * outputs]);
    let width = plan.frames() * channels;
    let mut by_lowered = Tensor::zeros([rows, width], &device);
    let mut by_kernel: Vec<Option<Tensor<B, 2>>> = vec![None; plan.kernel()];
    for product in plan.products() {
        let outer = wide.clone().narrow(1, product.output * outputs, outputs);
        let from = product.frames.start * channels;
        let length = product.frames.len() * channels;
        let rows_of_kernel = kernel_rows(plan, &product, weight.clone()).transpose();
        let change = outer.clone().matmul(rows_of_kernel);
        let before = Tensor::zeros([rows, from], &device);
        let after = Tensor::zeros([rows, width - from - length], &device);
        by_lowered = by_lowered + Tensor::cat(vec![before, change, after], 1);
        let columns = columns(plan, &product, lowered.clone());
        let change = columns.transpose().matmul(outer);
        for (place, &tap) in product.taps.iter().enumerate() {
            if let Some(slot) = by_kernel.get_mut(tap) {
                *slot = Some(change.clone().narrow(0, place * channels, channels));
            }
        }
    }
    let by_input = raise(plan, by_lowered.reshape([batch, plan.rows(time), width]), time);
    let by_input = if plan.rectified {
        by_input.mask_fill(input.lower_equal_elem(0.0), 0.0)
    } else {
        by_input
    };
    Affine {
        input: by_input,
        weight: Tensor::cat(by_kernel.into_iter().flatten().collect(), 0)
            .reshape([plan.kernel() * channels * outputs]),
        bias: outer.sum_dim(0).sum_dim(1).reshape([outputs]),
    }
}

/// `[batch, time, in]` to `[batch * rows, frames * in]`.
fn lower<B: Backend>(plan: Convolution, input: Tensor<B, 3>) -> Tensor<B, 2> {
    let [batch, time, channels] = input.dims();
    let input = if plan.rectified { relu(input) } else { input };
    let rows = plan.rows(time);
    let slices = |padding: usize, step: usize, count: usize| {
        let padded = padded(input.clone(), padding);
        let slices = (0..count).map(|frame| padded.clone().narrow(1, frame * step, rows));
        Tensor::cat(slices.collect(), 2)
    };
    let lowered = match plan.kind {
        Kind::Pointwise => input,
        Kind::Dilated(dilation) => slices(dilation, dilation, 3),
        Kind::Doubling => slices(1, 1, 3),
        Kind::Halving => {
            // Two neighbouring frames side by side: a kernel of 4 is a kernel of 2 over pairs.
            let pairs = padded(input, 1).reshape([batch, rows + 1, 2 * channels]);
            let slices = (0..2).map(|pair| pairs.clone().narrow(1, pair, rows));
            Tensor::cat(slices.collect(), 2)
        }
    };
    lowered.reshape([batch * rows, plan.frames() * channels])
}

/// The transpose of [`lower`]: every value goes back to the frame that it came from.
fn raise<B: Backend>(plan: Convolution, lowered: Tensor<B, 3>, time: usize) -> Tensor<B, 3> {
    let [batch, rows, width] = lowered.dims();
    let channels = width / plan.frames();
    let device = lowered.device();
    let (padding, step, unit) = match plan.kind {
        Kind::Pointwise => return lowered,
        Kind::Dilated(dilation) => (dilation, dilation, 1),
        Kind::Doubling => (1, 1, 1),
        Kind::Halving => (1, 1, 2),
    };
    let total = (time + 2 * padding) / unit;
    let parts = (0..plan.frames() / unit).map(|frame| {
        let width = unit * channels;
        let slice = lowered.clone().narrow(2, frame * width, width);
        let zeros = |length| Tensor::zeros([batch, length, width], &device);
        let before = frame * step;
        Tensor::cat(vec![zeros(before), slice, zeros(total - before - rows)], 1)
    });
    let summed = parts.reduce(|sum, part| sum + part);
    let summed = summed.unwrap_or_else(|| Tensor::zeros([batch, total, unit * channels], &device));
    summed.reshape([batch, time + 2 * padding, channels]).narrow(1, padding, time)
}

fn columns<B: Backend>(
    plan: Convolution,
    product: &Product,
    lowered: Tensor<B, 2>,
) -> Tensor<B, 2> {
    let channels = plan.inputs;
    lowered.narrow(1, product.frames.start * channels, product.frames.len() * channels)
}

/// The parts of the kernel that a product needs, `[frames * in, out]`.
fn kernel_rows<B: Backend>(
    plan: Convolution,
    product: &Product,
    weight: Tensor<B, 1>,
) -> Tensor<B, 2> {
    let (channels, outputs) = (plan.inputs, plan.outputs);
    let weight: Tensor<B, 2> = weight.reshape([plan.kernel() * channels, outputs]);
    let taps = product.taps.iter();
    let parts = taps.map(|tap| weight.clone().narrow(0, tap * channels, channels));
    Tensor::cat(parts.collect(), 0)
}

/// Zeros of `length` frames at both ends.
fn padded<B: Backend>(input: Tensor<B, 3>, length: usize) -> Tensor<B, 3> {
    let [batch, _, channels] = input.dims();
    let zeros = Tensor::zeros([batch, length, channels], &input.device());
    Tensor::cat(vec![zeros.clone(), input, zeros], 1)
}

pub(super) fn gelu_backward<B: Backend>(input: Tensor<B, 3>, outer: Tensor<B, 3>) -> Tensor<B, 3> {
    let [input, outer] = [input, outer].map(|tensor| tensor.into_primitive().tensor());
    Tensor::from_primitive(TensorPrimitive::Float(B::gelu_backward(input, outer)))
}

/// Rows at mean 0 and spread 1, and one over their spread.
fn standardised<B: Backend>(input: Tensor<B, 3>) -> (Tensor<B, 3>, Tensor<B, 3>) {
    let centred = input.clone() - input.mean_dim(2);
    let variance = centred.clone().square().mean_dim(2);
    let scale = variance.add_scalar(NORM_EPSILON).sqrt().recip();
    (centred * scale.clone(), scale)
}

pub(super) fn normalise<B: Backend>(Affine { input, weight, bias }: Affine<B>) -> Tensor<B, 3> {
    let (standard, _) = standardised(input);
    standard * weight.unsqueeze::<3>() + bias.unsqueeze::<3>()
}

pub(super) fn normalise_backward<B: Backend>(
    Affine { input, weight, .. }: Affine<B>,
    outer: Tensor<B, 3>,
) -> Affine<B> {
    let [channels] = weight.dims();
    let (standard, scale) = standardised(input);
    let rows = |tensor: Tensor<B, 3>| tensor.sum_dim(0).sum_dim(1).reshape([channels]);
    let by_standard = outer.clone() * weight.unsqueeze::<3>();
    let plain = by_standard.clone().mean_dim(2);
    let along = (by_standard.clone() * standard.clone()).mean_dim(2);
    Affine {
        input: scale * (by_standard - plain - standard.clone() * along),
        weight: rows(outer.clone() * standard),
        bias: rows(outer),
    }
}

/// `[batch, length, channels]` to `[batch, heads, length, size]`.
fn split<B: Backend>(heads: usize, tensor: Tensor<B, 3>) -> Tensor<B, 4> {
    let [batch, length, channels] = tensor.dims();
    let size = channels / heads;
    let tensor = tensor.reshape([batch, length, heads, size]);
    tensor.swap_dims(1, 2)
}

/// The opposite of [`split`].
fn joined<B: Backend>(tensor: Tensor<B, 4>) -> Tensor<B, 3> {
    let [batch, heads, length, size] = tensor.dims();
    tensor.swap_dims(1, 2).reshape([batch, length, heads * size])
}

/// Shares of the values, `[batch, heads, length, length]`, and the factor of the scores.
fn shares<B: Backend>(
    heads: usize,
    query: Tensor<B, 3>,
    key: Tensor<B, 3>,
    forbidden: Tensor<B, 2, Bool>,
) -> (Tensor<B, 4>, f64) {
    let (query, key) = (split(heads, query), split(heads, key));
    let [batch, heads, length, size] = query.dims();
    let scale = 1.0 / (size as f64).sqrt();
    let scores = query.mul_scalar(scale).matmul(key.swap_dims(2, 3));
    let forbidden = forbidden.unsqueeze::<4>().expand([batch, heads, length, length]);
    (softmax(scores.mask_fill(forbidden, f32::NEG_INFINITY), 3), scale)
}

fn dropped<B: Backend>(shares: Tensor<B, 4>, kept: Option<Tensor<B, 4>>) -> Tensor<B, 4> {
    match kept {
        Some(kept) => shares * kept,
        None => shares,
    }
}

pub(super) fn attend<B: Backend>(inputs: AttentionInputs<B>) -> Tensor<B, 3> {
    let AttentionInputs { heads, queries, forbidden, kept } = inputs;
    let (shares, _) = shares(heads, queries.query, queries.key, forbidden);
    joined(dropped(shares, kept).matmul(split(heads, queries.value)))
}

pub(super) fn attend_backward<B: Backend>(
    inputs: AttentionInputs<B>,
    outer: Tensor<B, 3>,
) -> Queries<B> {
    let AttentionInputs { heads, queries, forbidden, kept } = inputs;
    let Queries { query, key, value } = queries;
    let (shares, scale) = shares(heads, query.clone(), key.clone(), forbidden);
    let outer = split(heads, outer);
    let by_value = dropped(shares.clone(), kept.clone()).swap_dims(2, 3).matmul(outer.clone());
    let by_shares = dropped(outer.matmul(split(heads, value).swap_dims(2, 3)), kept);
    let along = (by_shares.clone() * shares.clone()).sum_dim(3);
    let by_scores = (shares * (by_shares - along)).mul_scalar(scale);
    Queries {
        query: joined(by_scores.clone().matmul(split(heads, key))),
        key: joined(by_scores.swap_dims(2, 3).matmul(split(heads, query))),
        value: joined(by_value),
    }
}

pub(super) fn descend<B: Backend>(
    step: Descent,
    tensor: Tensor<B, 1>,
    gradient: Tensor<B, 1>,
    [first, second]: [Tensor<B, 1>; 2],
) -> (Tensor<B, 1>, [Tensor<B, 1>; 2]) {
    let ([beta1, beta2], [correction1, correction2]) = (step.betas, step.corrections);
    let first = first.mul_scalar(beta1) + gradient.clone().mul_scalar(1.0 - beta1);
    let second = second.mul_scalar(beta2) + gradient.square().mul_scalar(1.0 - beta2);
    let spread = second.clone().div_scalar(correction2).sqrt();
    let spread = spread.add_scalar(step.epsilon);
    let change = first.clone().mul_scalar(step.rate / correction1) / spread;
    (tensor - change, [first, second])
}

pub(super) fn kept<B: Backend, const D: usize>(like: &Tensor<B, D>, share: f64) -> Tensor<B, D> {
    let kept = like.random_like(Distribution::Bernoulli(1.0 - share));
    kept.mul_scalar(1.0 / (1.0 - share))
}
