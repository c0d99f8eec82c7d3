//! The CPU's kernels and their derivatives against the plain ones, and the plain derivatives
//! against what automatic derivatives make of the plain forward passes.

use burn_autodiff::Autodiff;
use burn_flex::{Flex, FlexDevice};
use burn_tensor::{Bool, Distribution, Tensor, TensorData, backend::Backend};

use crate::{Affine, AttentionInputs, Convolution, Descent, Kernels, Kind, Queries, plain};

type Traced = Autodiff<Flex>;

const KINDS: [Kind; 5] =
    [Kind::Pointwise, Kind::Dilated(1), Kind::Dilated(9), Kind::Halving, Kind::Doubling];
const TOLERANCE: f32 = 2e-5;

fn random<const D: usize>(shape: [usize; D], seed: u64) -> Tensor<Flex, D> {
    Flex::seed(&FlexDevice, seed);
    Tensor::random(shape, Distribution::Normal(0.0, 1.0), &FlexDevice)
}

fn close<const D: usize>(found: Tensor<Flex, D>, wanted: Tensor<Flex, D>, what: &str) {
    assert_eq!(found.dims(), wanted.dims(), "{what}");
    let scale = wanted.clone().abs().mean().into_scalar().max(1.0);
    let error = (found - wanted).abs().max().into_scalar();
    assert!(error <= TOLERANCE * scale, "{what}: {error} at {scale}");
}

fn traced<const D: usize>(tensor: &Tensor<Flex, D>) -> Tensor<Traced, D> {
    Tensor::from_inner(tensor.clone()).require_grad()
}

#[test]
fn convolutions_agree() {
    // Enough pieces for several groups, and one that is not full.
    for (kind, rectified) in KINDS.iter().flat_map(|&kind| [(kind, false), (kind, true)]) {
        let plan = Convolution { kind, rectified, inputs: 5, outputs: 7 };
        let affine = Affine {
            input: random([31, 26, 5], 1),
            weight: random([plan.kernel() * 35], 2),
            bias: random([7], 3),
        };
        let what = format!("{plan:?}");
        let leaves = leaves(&affine);
        let result = plain::convolve(plan, leaves.clone());
        close(Flex::convolve(plan, affine.clone()), result.clone().inner(), &what);
        let outer = random(result.dims(), 4);
        let found = Flex::convolve_backward(plan, affine.clone(), outer.clone());
        let own = plain::convolve_backward(plan, affine, outer.clone());
        derivatives_agree(&leaves, result, outer, [found, own]);
    }
}

fn leaves(affine: &Affine<Flex>) -> Affine<Traced> {
    Affine {
        input: traced(&affine.input),
        weight: traced(&affine.weight),
        bias: traced(&affine.bias),
    }
}

/// Compares derivatives with the automatic ones of `result`.
fn derivatives_agree(
    leaves: &Affine<Traced>,
    result: Tensor<Traced, 3>,
    outer: Tensor<Flex, 3>,
    found: [Affine<Flex>; 2],
) {
    let gradients = (result * Tensor::from_inner(outer)).sum().backward();
    for gradient in found {
        close(gradient.input, leaves.input.grad(&gradients).unwrap(), "input");
        close(gradient.weight, leaves.weight.grad(&gradients).unwrap(), "weight");
        close(gradient.bias, leaves.bias.grad(&gradients).unwrap(), "bias");
    }
}

#[test]
fn gelu_agrees() {
    let input = random([3, 50, 200], 1).mul_scalar(3.0);
    let outer = random([3, 50, 200], 2);
    let leaf = traced(&input);
    let result = burn_tensor::activation::gelu(leaf.clone());
    close(Flex::activate(input.clone()), result.clone().inner(), "gelu");
    let gradients = (result * Tensor::from_inner(outer.clone())).sum().backward();
    let wanted = leaf.grad(&gradients).unwrap();
    close(Flex::activate_backward(input.clone(), outer.clone()), wanted.clone(), "derivative");
    close(plain::gelu_backward(input, outer), wanted, "plain derivative");
}

#[test]
fn normalisations_agree() {
    let affine = Affine {
        input: random([3, 101, 40], 1).mul_scalar(3.0).add_scalar(5.0),
        weight: random([40], 2),
        bias: random([40], 3),
    };
    let outer = random([3, 101, 40], 4);
    let leaves = leaves(&affine);
    let result = plain::normalise(leaves.clone());
    close(Flex::normalise(affine.clone()), result.clone().inner(), "normalise");
    let found = Flex::normalise_backward(affine.clone(), outer.clone());
    let own = plain::normalise_backward(affine, outer.clone());
    derivatives_agree(&leaves, result, outer, [found, own]);
}

#[test]
fn attention_agrees() {
    let (heads, length) = (4, 9);
    let part = |seed| random([5, length, 24], seed);
    let queries = Queries { query: part(1), key: part(2), value: part(3) };
    let outer = part(4);
    let mask: Vec<bool> = (0..length * length).map(|flat| flat % length > flat / length).collect();
    for kept in [None, Some(Flex::kept(&random([5, heads, length, length], 5), 0.3))] {
        let leaves = Queries {
            query: traced(&queries.query),
            key: traced(&queries.key),
            value: traced(&queries.value),
        };
        let result = plain::attend(AttentionInputs {
            heads,
            queries: leaves.clone(),
            forbidden: forbidden(&mask),
            kept: kept.clone().map(Tensor::from_inner),
        });
        let inputs =
            AttentionInputs { heads, queries: queries.clone(), forbidden: forbidden(&mask), kept };
        close(Flex::attend(inputs.clone()), result.clone().inner(), "attention");
        let gradients = (result * Tensor::from_inner(outer.clone())).sum().backward();
        let found = Flex::attend_backward(inputs.clone(), outer.clone());
        let own = plain::attend_backward(inputs, outer.clone());
        for gradient in [found, own] {
            close(gradient.query, leaves.query.grad(&gradients).unwrap(), "query");
            close(gradient.key, leaves.key.grad(&gradients).unwrap(), "key");
            close(gradient.value, leaves.value.grad(&gradients).unwrap(), "value");
        }
    }
}

/// A square mask.
fn forbidden<B: Backend<Device = FlexDevice>>(mask: &[bool]) -> Tensor<B, 2, Bool> {
    let length = mask.len().isqrt();
    Tensor::from_data(TensorData::new(mask.to_vec(), [length, length]), &FlexDevice)
}

#[test]
fn descents_agree() {
    let step = Descent { betas: [0.9, 0.99], corrections: [0.3, 0.05], rate: 0.01, epsilon: 1e-8 };
    // Once each: other tests seed the same generator meanwhile.
    let [tensor, gradient, first, second] = [1, 2, 3, 4].map(|seed| random([40_000], seed));
    let moments = [first, second.abs()];
    let (found, [first, second]) =
        Flex::descend(step, tensor.clone(), gradient.clone(), moments.clone());
    let (wanted, [one, two]) = plain::descend(step, tensor, gradient, moments);
    close(found, wanted, "tensor");
    close(first, one, "first moment");
    close(second, two, "second moment");
}

#[test]
fn automatic_derivatives_know_the_kernels() {
    let input = random([2, 8, 6], 1);
    let plan = Convolution { kind: Kind::Pointwise, rectified: false, inputs: 6, outputs: 6 };
    let leaf = traced(&input);
    let affine = Affine {
        input: leaf.clone(),
        weight: Tensor::from_inner(random([6 * 6], 2)),
        bias: Tensor::from_inner(random([6], 3)),
    };
    let hidden = Traced::convolve(plan, affine);
    let key = Traced::activate(hidden.clone());
    let value = Traced::normalise(unit(hidden.clone()));
    let loss = Traced::attend(all_seen(hidden, key, value)).square().sum();
    let value = |input: Tensor<Flex, 3>| {
        let affine = Affine { input, weight: random([6 * 6], 2), bias: random([6], 3) };
        let hidden = plain::convolve(plan, affine);
        let key = burn_tensor::activation::gelu(hidden.clone());
        let value = plain::normalise(unit(hidden.clone()));
        plain::attend(all_seen(hidden, key, value)).square().sum().into_scalar()
    };
    assert!((loss.clone().inner().into_scalar() - value(input.clone())).abs() < 1e-3);
    let gradient = leaf.grad(&loss.backward()).unwrap();
    // Along a random direction.
    let direction = random([2, 8, 6], 9);
    let step = 1e-2;
    let there = value(input.clone() + direction.clone().mul_scalar(step));
    let back = value(input - direction.clone().mul_scalar(step));
    let wanted = (there - back) / (2.0 * step);
    let found = (gradient * direction).sum().into_scalar();
    assert!((found - wanted).abs() < 0.01 * wanted.abs().max(1.0), "{found} {wanted}");
}

/// A normalisation that leaves mean and spread as they are.
fn unit<B: Backend<Device = FlexDevice>>(input: Tensor<B, 3>) -> Affine<B> {
    let (weight, bias) = (Tensor::ones([6], &FlexDevice), Tensor::zeros([6], &FlexDevice));
    Affine { input, weight, bias }
}

/// Two heads over 8 tokens that all see each other.
fn all_seen<B: Backend<Device = FlexDevice>>(
    query: Tensor<B, 3>,
    key: Tensor<B, 3>,
    value: Tensor<B, 3>,
) -> AttentionInputs<B> {
    let queries = Queries { query, key, value };
    AttentionInputs { heads: 2, queries, forbidden: forbidden(&[false; 64]), kept: None }
}
