//! The CPU's kernels and their derivatives against the plain ones, and the plain derivatives
//! against what automatic derivatives make of the plain forward passes.

use burn_autodiff::Autodiff;
use burn_flex::{Flex, FlexDevice};
use burn_tensor::{Bool, Distribution, Tensor, TensorData, backend::Backend};

use super::{Convolution, Descent, Heads, Kernels, Kind, Queries, plain};

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
        let input = random([31, 26, 5], 1);
        let weight = random([plan.kernel() * 35], 2);
        let bias = random([7], 3);
        let what = format!("{plan:?}");
        let wanted = plain::convolve(plan, input.clone(), weight.clone(), bias.clone());
        let outer = random(wanted.dims(), 4);
        let found = Flex::convolve(plan, input.clone(), weight.clone(), bias.clone());
        close(found, wanted, &what);

        let found = Flex::convolve_backward(plan, input.clone(), weight.clone(), outer.clone());
        let own = plain::convolve_backward(plan, input.clone(), weight.clone(), outer.clone());
        let leaves = (traced(&input), traced(&weight), traced(&bias));
        let result = plain::convolve(plan, leaves.0.clone(), leaves.1.clone(), leaves.2.clone());
        let gradients = (result * Tensor::from_inner(outer)).sum().backward();
        for gradient in [found, own] {
            close(gradient.input, leaves.0.grad(&gradients).unwrap(), &what);
            close(gradient.weight, leaves.1.grad(&gradients).unwrap(), &what);
            close(gradient.bias, leaves.2.grad(&gradients).unwrap(), &what);
        }
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
    let input = random([3, 101, 40], 1).mul_scalar(3.0).add_scalar(5.0);
    let (weight, bias) = (random([40], 2), random([40], 3));
    let outer = random([3, 101, 40], 4);
    let leaves = (traced(&input), traced(&weight), traced(&bias));
    let result = plain::normalise(leaves.0.clone(), leaves.1.clone(), leaves.2.clone());
    let found = Flex::normalise(input.clone(), weight.clone(), bias);
    close(found, result.clone().inner(), "normalise");
    let gradients = (result * Tensor::from_inner(outer.clone())).sum().backward();
    let found = Flex::normalise_backward(input.clone(), weight.clone(), outer.clone());
    let own = plain::normalise_backward(input, weight, outer);
    for gradient in [found, own] {
        close(gradient.input, leaves.0.grad(&gradients).unwrap(), "input");
        close(gradient.weight, leaves.1.grad(&gradients).unwrap(), "weight");
        close(gradient.bias, leaves.2.grad(&gradients).unwrap(), "bias");
    }
}

#[test]
fn attention_agrees() {
    let (heads, length) = (Heads { count: 4 }, 9);
    let part = |seed| random([5, length, 24], seed);
    let queries = Queries { query: part(1), key: part(2), value: part(3) };
    let outer = part(4);
    let forbidden: Vec<bool> =
        (0..length * length).map(|flat| flat % length > flat / length).collect();
    let forbidden = TensorData::new(forbidden, [length, length]);
    let mask = Tensor::<Flex, 2, Bool>::from_data(forbidden.clone(), &FlexDevice);
    for kept in [None, Some(Flex::kept(&random([5, 4, length, length], 5), 0.3))] {
        let leaves = Queries {
            query: traced(&queries.query),
            key: traced(&queries.key),
            value: traced(&queries.value),
        };
        let result = plain::attend(
            heads,
            leaves.clone(),
            Tensor::from_data(forbidden.clone(), &FlexDevice),
            kept.clone().map(Tensor::from_inner),
        );
        let found = Flex::attend(heads, queries.clone(), mask.clone(), kept.clone());
        close(found, result.clone().inner(), "attention");
        let gradients = (result * Tensor::from_inner(outer.clone())).sum().backward();
        let arguments = || (queries.clone(), mask.clone(), kept.clone(), outer.clone());
        let (q, m, k, o) = arguments();
        let found = Flex::attend_backward(heads, q, m, k, o);
        let (q, m, k, o) = arguments();
        let own = plain::attend_backward(heads, q, m, k, o);
        for gradient in [found, own] {
            close(gradient.query, leaves.query.grad(&gradients).unwrap(), "query");
            close(gradient.key, leaves.key.grad(&gradients).unwrap(), "key");
            close(gradient.value, leaves.value.grad(&gradients).unwrap(), "value");
        }
    }
}

#[test]
fn descents_agree() {
    let step = Descent { betas: [0.9, 0.99], corrections: [0.3, 0.05], rate: 0.01, epsilon: 1e-8 };
    let part = |seed| random([40_000], seed);
    let moments = || [part(3), part(4).abs()];
    let (found, [first, second]) = Flex::descend(step, part(1), part(2), moments());
    let (wanted, [one, two]) = plain::descend(step, part(1), part(2), moments());
    close(found, wanted, "tensor");
    close(first, one, "first moment");
    close(second, two, "second moment");
}

#[test]
fn automatic_derivatives_know_the_kernels() {
    let input = random([2, 8, 6], 1);
    let (weight, bias) = (random([6 * 6], 2), random([6], 3));
    let plan = Convolution { kind: Kind::Pointwise, rectified: false, inputs: 6, outputs: 6 };
    let leaf = traced(&input);
    let (weight, bias) = (Tensor::from_inner(weight), Tensor::from_inner(bias));
    let hidden = Traced::convolve(plan, leaf.clone(), weight, bias);
    let queries = Queries {
        query: hidden.clone(),
        key: Traced::activate(hidden.clone()),
        value: Traced::normalise(
            hidden,
            Tensor::ones([6], &FlexDevice),
            Tensor::zeros([6], &FlexDevice),
        ),
    };
    let mask =
        Tensor::<Traced, 2, Bool>::from_data(TensorData::new(vec![false; 64], [8, 8]), &FlexDevice);
    let loss = Traced::attend(Heads { count: 2 }, queries, mask, None).square().sum();
    let value = |input: Tensor<Flex, 3>| {
        let weight = random([6 * 6], 2);
        let hidden = plain::convolve(plan, input, weight, random([6], 3));
        let queries = Queries {
            query: hidden.clone(),
            key: burn_tensor::activation::gelu(hidden.clone()),
            value: plain::normalise(
                hidden,
                Tensor::ones([6], &FlexDevice),
                Tensor::zeros([6], &FlexDevice),
            ),
        };
        let mask = Tensor::<Flex, 2, Bool>::from_data(
            TensorData::new(vec![false; 64], [8, 8]),
            &FlexDevice,
        );
        let result = plain::attend(Heads { count: 2 }, queries, mask, None);
        result.square().sum().into_scalar()
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
