//! Loss of a model by quantisation: it and its original predict the same recordings.

use std::{fmt, path::PathBuf};

use bailando::model::ModelDirectory;
use clap::Args;
use ndarray::{Array2, ArrayView1};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::{
    data::{Portion, Split, SplitKind},
    encode::EncodeError,
    held_out::{Predictor, Recordings, cross_entropies, pairs},
};

/// What to compare.
#[derive(Args, Clone, Debug)]
pub struct CompareOptions {
    /// Model directory of the original
    #[arg(value_name = "ORIGINAL")]
    pub original: PathBuf,
    /// Model directory of the other; both have one VQ-VAE
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// The recordings that they predict.
    #[command(flatten)]
    pub recordings: Recordings,
}

/// Two models beside each other, true codes given before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Codes of both halves that were predicted.
    pub codes: usize,
    /// Share of codes that both hold for the likeliest.
    pub same_likeliest: f64,
    /// Share of codes that both draw with the same random number at temperature 1.
    pub same_drawn: f64,
    /// `exp` of the original's cross-entropy of a pair of codes.
    pub perplexity_of_original: f64,
    /// The same of the other.
    pub perplexity: f64,
    /// Divergence of the other from the original, nats a code.
    pub divergence: f64,
    /// Bytes of the original's GPT.
    pub bytes_of_original: u64,
    /// The same of the other.
    pub bytes: u64,
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "| | original | model |\n|---|---|---|")?;
        let megabytes = |bytes: u64| bytes as f64 / 1e6;
        let (original, model) = (megabytes(self.bytes_of_original), megabytes(self.bytes));
        writeln!(f, "| gpt.onnx, MB | {original:.1} | {model:.1} |")?;
        let (original, model) = (self.perplexity_of_original, self.perplexity);
        writeln!(f, "| perplexity of a code pair | {original:.5} | {model:.5} |")?;
        writeln!(
            f,
            "\nOf {} codes {:.3} % are the likeliest to both, {:.3} % are drawn by both; \
             divergence {:.2e} nats",
            self.codes,
            100.0 * self.same_likeliest,
            100.0 * self.same_drawn,
            self.divergence
        )
    }
}

/// Compares two models on the recordings and songs of a split.
///
/// # Errors
/// [`EncodeError`]: the data, a model, or a recording that cannot be encoded.
pub fn compare(options: &CompareOptions) -> Result<Comparison, EncodeError> {
    let dataset = options.recordings.open()?;
    match options.recordings.split {
        Split::Train => measure(&dataset.training()?, options),
        Split::Test => measure(&dataset.evaluation()?, options),
    }
}

fn measure<S: SplitKind>(
    portion: &Portion<S>,
    options: &CompareOptions,
) -> Result<Comparison, EncodeError> {
    let original = ModelDirectory::open(&options.original)?;
    let model = ModelDirectory::open(&options.model)?;
    let pairs = pairs(portion, &original, options.recordings.cache.as_deref())?;
    let mut predictors = [Predictor::open(&original)?, Predictor::open(&model)?];
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let mut sums = Sums::default();
    for pair in &pairs {
        let [first, second] = &mut predictors;
        let rows = pair.rows.view();
        let both = first.predicted(pair, rows)?.into_iter();
        for ((one, codes), (other, _)) in both.zip(second.predicted(pair, rows)?) {
            sums.add(&one.upper, &other.upper, codes[0], &mut random);
            sums.add(&one.lower, &other.lower, codes[1], &mut random);
        }
    }
    let size = |directory: &ModelDirectory| {
        directory.manifest().files.get("gpt.onnx").map_or(0, |file| file.bytes)
    };
    Ok(Comparison { bytes_of_original: size(&original), bytes: size(&model), ..sums.comparison() })
}

#[derive(Default)]
struct Sums {
    codes: usize,
    same_likeliest: usize,
    same_drawn: usize,
    entropies: [f64; 2],
    divergence: f64,
}

impl Sums {
    /// Takes the scores of some codes of one half, by both models.
    fn add(
        &mut self,
        original: &Array2<f32>,
        model: &Array2<f32>,
        codes: &[u32],
        random: &mut ChaCha8Rng,
    ) {
        for (sum, logits) in self.entropies.iter_mut().zip([original, model]) {
            *sum += cross_entropies(logits, codes).iter().sum::<f64>();
        }
        for (one, other) in original.rows().into_iter().zip(model.rows()) {
            let [one, other] = [one, other].map(shares);
            let number = random.random();
            self.codes += 1;
            self.same_likeliest += usize::from(likeliest(&one) == likeliest(&other));
            self.same_drawn += usize::from(drawn(&one, number) == drawn(&other, number));
            let terms = one.iter().zip(&other).filter(|(p, _)| **p > 0.0);
            self.divergence +=
                terms.map(|(p, q)| p * (p / q.max(f64::MIN_POSITIVE)).ln()).sum::<f64>();
        }
    }

    fn comparison(&self) -> Comparison {
        let codes = self.codes.max(1) as f64;
        // A pair is a code of each half.
        let [original, model] = self.entropies.map(|sum| (2.0 * sum / codes).exp());
        Comparison {
            codes: self.codes,
            same_likeliest: self.same_likeliest as f64 / codes,
            same_drawn: self.same_drawn as f64 / codes,
            perplexity_of_original: original,
            perplexity: model,
            divergence: self.divergence / codes,
            ..Comparison::default()
        }
    }
}

fn shares(logits: ArrayView1<'_, f32>) -> Vec<f64> {
    let highest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let weights = logits.iter().map(|&logit| f64::from(logit - highest).exp());
    let weights: Vec<f64> = weights.collect();
    let total: f64 = weights.iter().sum();
    weights.into_iter().map(|weight| weight / total).collect()
}

fn likeliest(shares: &[f64]) -> usize {
    (0..shares.len()).fold(0, |best, code| if shares[code] > shares[best] { code } else { best })
}

/// The code at which the shares, likeliest first, reach `number` in 0..1: as the server draws.
fn drawn(shares: &[f64], number: f64) -> usize {
    let mut order: Vec<usize> = (0..shares.len()).collect();
    order.sort_by(|&a, &b| shares[b].total_cmp(&shares[a]).then(a.cmp(&b)));
    let mut rest = number;
    let reached = order.iter().find(|&&code| {
        rest -= shares[code];
        rest < 0.0
    });
    reached.or(order.last()).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn a_model_is_its_own_equal_and_another_is_not() {
        let logits = array![[0.0, 1.0, 2.0], [3.0, 0.0, 0.0]];
        let other = array![[0.0, 2.0, 1.0], [3.0, 0.0, 0.0]];
        let codes = [2, 0];
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut same = Sums::default();
        same.add(&logits, &logits, &codes, &mut random);
        let found = same.comparison();
        assert_eq!((found.same_likeliest, found.same_drawn), (1.0, 1.0));
        assert!(found.divergence.abs() < 1e-12);
        let entropies = cross_entropies(&logits, &codes);
        let wanted = (entropies[0] + entropies[1]).exp();
        assert!((found.perplexity - wanted).abs() < 1e-9);

        let mut apart = Sums::default();
        apart.add(&logits, &other, &codes, &mut random);
        let found = apart.comparison();
        assert_eq!(found.same_likeliest, 0.5);
        // Codes 1 and 2 change places: p2 - p1 times the logarithm of their ratio, over two codes.
        let total = 1.0 + 1_f64.exp() + 2_f64.exp();
        let wanted = (2_f64.exp() - 1_f64.exp()) / total / 2.0;
        assert!((found.divergence - wanted).abs() < 1e-9);
        assert!(found.perplexity > found.perplexity_of_original);
    }

    #[test]
    fn the_likeliest_is_drawn_first() {
        let shares = [0.2, 0.5, 0.3];
        for (number, code) in [(0.0, 1), (0.49, 1), (0.51, 2), (0.79, 2), (0.81, 0), (1.0, 0)] {
            assert_eq!(drawn(&shares, number), code, "{number}");
        }
    }
}
