//! Operations on single values or rows, many values at a time.

use burn_flex::Flex;
use burn_tensor::{Distribution, Tensor};
use rayon::prelude::*;

use super::memory::{add, host, tensor, values};
use crate::{Affine, operands::NORM_EPSILON};

/// Values that one thread takes at a time.
const PART: usize = 16_384;
/// Rows of a normalisation that one thread takes at a time.
const ROWS: usize = 128;

/// `e` to the power of `x`, within 2e-7 of it; nothing below -87. Without branches or calls, so
/// that the compiler does several at once.
#[inline(always)]
pub(super) fn exp(x: f32) -> f32 {
    const LOG2_E: f32 = std::f32::consts::LOG2_E;
    // ln 2 in two parts, so that the rest keeps its digits.
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    /// Adding and taking off rounds to a whole number.
    const ROUND: f32 = 12_582_912.0;
    let x = x.clamp(-87.0, 88.0);
    let whole = (x * LOG2_E + ROUND) - ROUND;
    let rest = x - whole * LN2_HIGH - whole * LN2_LOW;
    // Taylor's series up to the 7th power: `rest` is at most 0.35.
    let series = 1.0 / 5_040.0;
    let series = series * rest + 1.0 / 720.0;
    let series = series * rest + 1.0 / 120.0;
    let series = series * rest + 1.0 / 24.0;
    let series = series * rest + 1.0 / 6.0;
    let series = series * rest + 0.5;
    let series = series * rest * rest + rest + 1.0;
    let power = f32::from_bits(((whole as i32 + 127) as u32) << 23);
    if x <= -87.0 { 0.0 } else { series * power }
}

/// The share of a normal distribution below `x`, within 1.5e-7 (Abramowitz and Stegun 7.1.26), and
/// its density.
#[inline(always)]
fn normal(x: f32) -> (f32, f32) {
    const DENSITY: f32 = 0.398_942_3;
    let root = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * root);
    let series = 1.061_405_4 * t - 1.453_152;
    let series = series * t + 1.421_413_7;
    let series = series * t - 0.284_496_74;
    let series = series * t + 0.254_829_6;
    let fall = exp(-root * root);
    let beyond = 0.5 * series * t * fall;
    let below = if x < 0.0 { beyond } else { 1.0 - beyond };
    (below, DENSITY * fall)
}

pub(super) fn gelu(input: Tensor<Flex, 3>) -> Tensor<Flex, 3> {
    let shape = input.dims();
    let input = host(input);
    let mut output = vec![0.0; values(&input).len()];
    output.par_chunks_mut(PART).zip(values(&input).par_chunks(PART)).for_each(|(output, input)| {
        for (output, &x) in output.iter_mut().zip(input) {
            *output = x * normal(x).0;
        }
    });
    tensor(output, shape)
}

pub(super) fn gelu_backward(input: Tensor<Flex, 3>, outer: Tensor<Flex, 3>) -> Tensor<Flex, 3> {
    let shape = input.dims();
    let (input, outer) = (host(input), host(outer));
    let mut output = vec![0.0; values(&input).len()];
    output
        .par_chunks_mut(PART)
        .zip(values(&input).par_chunks(PART))
        .zip(values(&outer).par_chunks(PART))
        .for_each(|((output, input), outer)| {
            for ((output, &x), outer) in output.iter_mut().zip(input).zip(outer) {
                let (below, density) = normal(x);
                *output = outer * (below + x * density);
            }
        });
    tensor(output, shape)
}

/// Mean and one over the spread of a row.
fn moments(row: &[f32]) -> (f32, f32) {
    let count = row.len() as f32;
    let mean = sum(row.iter().copied()) / count;
    let variance = sum(row.iter().map(|x| (x - mean) * (x - mean))) / count;
    (mean, 1.0 / (variance + NORM_EPSILON as f32).sqrt())
}

fn sum(values: impl Iterator<Item = f32>) -> f32 {
    values.map(f64::from).sum::<f64>() as f32
}

pub(super) fn normalise(Affine { input, weight, bias }: Affine<Flex>) -> Tensor<Flex, 3> {
    let shape = input.dims();
    let channels = shape[2].max(1);
    let (input, weight, bias) = (host(input), host(weight), host(bias));
    let (weight, bias) = (values(&weight), values(&bias));
    let mut output = vec![0.0; values(&input).len()];
    output
        .par_chunks_mut(ROWS * channels)
        .zip(values(&input).par_chunks(ROWS * channels))
        .for_each(|(output, input)| {
            let rows = output.chunks_mut(channels).zip(input.chunks(channels));
            for (output, input) in rows {
                let (mean, scale) = moments(input);
                let terms = input.iter().zip(weight).zip(bias);
                for (output, ((x, weight), bias)) in output.iter_mut().zip(terms) {
                    *output = (x - mean) * scale * weight + bias;
                }
            }
        });
    tensor(output, shape)
}

pub(super) fn normalise_backward(
    Affine { input, weight, .. }: Affine<Flex>,
    outer: Tensor<Flex, 3>,
) -> Affine<Flex> {
    let shape = input.dims();
    let channels = shape[2].max(1);
    let (input, weight, outer) = (host(input), host(weight), host(outer));
    let weight = values(&weight);
    let mut by_input = vec![0.0; values(&input).len()];
    let parts: Vec<[Vec<f32>; 2]> = by_input
        .par_chunks_mut(ROWS * channels)
        .zip(values(&input).par_chunks(ROWS * channels))
        .zip(values(&outer).par_chunks(ROWS * channels))
        .map(|((by_input, input), outer)| {
            let mut by_weight = vec![0.0; channels];
            let mut by_bias = vec![0.0; channels];
            let rows = by_input.chunks_mut(channels);
            let rows = rows.zip(input.chunks(channels)).zip(outer.chunks(channels));
            for ((by_input, input), outer) in rows {
                normalise_row_backward(
                    by_input,
                    (input, weight, outer),
                    [&mut by_weight, &mut by_bias],
                );
            }
            [by_weight, by_bias]
        })
        .collect();
    let total = |which: usize| {
        let mut total = vec![0.0; channels];
        for part in &parts {
            add(&mut total, &part[which]);
        }
        tensor(total, [channels])
    };
    Affine { weight: total(0), bias: total(1), input: tensor(by_input, shape) }
}

fn normalise_row_backward(
    by_input: &mut [f32],
    (input, weight, outer): (&[f32], &[f32], &[f32]),
    [by_weight, by_bias]: [&mut [f32]; 2],
) {
    let (mean, scale) = moments(input);
    let count = input.len() as f32;
    let terms = || input.iter().zip(weight).zip(outer);
    let plain = sum(terms().map(|((_, weight), outer)| weight * outer)) / count;
    let along =
        sum(terms().map(|((x, weight), outer)| weight * outer * (x - mean) * scale)) / count;
    for (by_input, ((x, weight), outer)) in by_input.iter_mut().zip(terms()) {
        *by_input = scale * (weight * outer - plain - (x - mean) * scale * along);
    }
    let sums = by_weight.iter_mut().zip(by_bias);
    for ((x, outer), (by_weight, by_bias)) in input.iter().zip(outer).zip(sums) {
        *by_weight += outer * (x - mean) * scale;
        *by_bias += outer;
    }
}

/// Values of a counter, mixed (the finaliser of splitmix64), instead of a generator that has to be
/// asked for them one after the other.
#[inline(always)]
fn mixed(seed: u64, count: u64) -> u64 {
    let mut x = seed.wrapping_add(count.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

pub(super) fn kept<const D: usize>(like: &Tensor<Flex, D>, share: f64) -> Tensor<Flex, D> {
    let shape = like.dims();
    // The backend's own generator, which the run seeds, gives the seed.
    let seed = Tensor::<Flex, 1>::random([4], Distribution::Uniform(0.0, 65_536.0), &like.device());
    let seed =
        values(&host(seed)).iter().fold(0, |seed, &part| seed << 16 | u64::from(part as u16));
    let limit = (share * u64::MAX as f64) as u64;
    let scale = (1.0 / (1.0 - share)) as f32;
    let mut output = vec![0.0; shape.iter().product()];
    let parts = output.par_chunks_mut(PART).enumerate();
    parts.for_each(|(part, output)| {
        for (place, output) in output.iter_mut().enumerate() {
            let drawn = mixed(seed, (part * PART + place) as u64);
            *output = if drawn < limit { 0.0 } else { scale };
        }
    });
    tensor(output, shape)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_within_its_bound() {
        for step in -8_600..8_700 {
            let x = step as f32 / 100.0;
            let wanted = f64::from(x).exp();
            let error = (f64::from(exp(x)) / wanted - 1.0).abs();
            assert!(error < 3e-7, "{x}: {error}");
        }
        assert_eq!(exp(-200.0), 0.0);
        assert_eq!(exp(f32::NEG_INFINITY), 0.0);
    }

    #[test]
    fn a_share_is_dropped_and_the_rest_scaled_up() {
        let like = Tensor::<Flex, 2>::zeros([300, 400], &Default::default());
        let kept = host(kept(&like, 0.25));
        let zeros = values(&kept).iter().filter(|&&x| x == 0.0).count();
        assert!((zeros as f64 / 120_000.0 - 0.25).abs() < 0.01, "{zeros}");
        assert!(values(&kept).iter().all(|&x| x == 0.0 || x == 4.0 / 3.0));
    }
}
