//! Input ranges of the exported network's 8-bit matrices (static quantisation).

use bailando::model::{Manner, WeightStorage};
use burn_flex::{Flex, FlexDevice};
use ndarray::Array2;
use rand::RngExt;

use super::{
    config::Config,
    policy::Policy,
    sampling::{Sampler, SamplingRequest},
    windows::generator,
};
use crate::{nn::Parameters, onnx::InputRanges};

/// Pieces that are generated, and their generators' seed.
const PIECES: u64 = 64;
const SEED: u64 = 0x6361_6c69;

/// Measures the ranges of every matrix's inputs while the policy generates, a window a piece.
///
/// The music is noise with mean and spread of the training's music, so that no data are needed;
/// training songs give nearly the same (docs/experiments.md, run 8). Without standardised music the
/// noise would be unlike anything in training, so there are no ranges, nor are there any where the
/// weights have more than 8 bits.
pub(super) fn input_ranges(config: &Config, policy: &Policy) -> InputRanges {
    if config.export.weights != WeightStorage::Int8 || !policy.scale.is_standardised() {
        return InputRanges::default();
    }
    let parameters = Parameters::<Flex>::from_store(&policy.store, &FlexDevice).observed();
    let sampler = Sampler {
        net: &policy.net,
        parameters: &parameters,
        temperature: f64::from(config.export.temperature),
    };
    let rows = policy.net.block() + 1;
    let music: Vec<_> = (0..PIECES).map(|piece| noise(policy, rows, piece)).collect();
    let requests = music.iter().zip(PIECES..).map(|(music, number)| {
        SamplingRequest::new(music.view(), &policy.starts, generator(SEED, number))
    });
    sampler.generate(requests.collect());
    let ranges = parameters.input_ranges(&policy.store).into_iter();
    ranges.map(|(name, range)| (in_graph(&name), range)).collect()
}

/// Returns scaled music without a pattern, `[rows, columns]`; columns in use have unit variance.
fn noise(policy: &Policy, rows: usize, piece: u64) -> Array2<f32> {
    let mut random = generator(SEED, piece);
    let spec = policy.manners.spec();
    let columns = policy.scale.mean.len() - spec.columns();
    let raw = Array2::from_shape_fn((rows, columns), |(_, column)| {
        let wide = 12.0_f64.sqrt() * (random.random::<f64>() - 0.5);
        policy.scale.mean[column] + policy.scale.spread[column] * wide as f32
    });
    // Every style, and none of them, one piece after the other.
    let style = piece as usize % (spec.styles + 1);
    let energy = Some(random.random::<f32>()).filter(|energy| *energy < 0.8);
    policy.scaled(&spec.beside(raw.view(), Manner { style: Some(style), energy }))
}

/// Returns the name in the exported graph, where queries, keys and values are one matrix.
fn in_graph(name: &str) -> String {
    name.replace(".query.", ".query_key_value.")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::{
        nn::{GptNet, GptSizes, Store, random_gpt},
        onnx::gpt_graph,
        training::{manners::Manners, music_scale::MusicScale, tests::config},
    };

    fn policy(spread: f32) -> Policy {
        let sizes =
            GptSizes { channels: 8, heads: 2, layers: 2, block: 6, codes: [5, 5], columns: 3 };
        let mut store = Store::default();
        Policy {
            net: GptNet::new(&random_gpt(sizes, 7), &mut store),
            store,
            scale: MusicScale { mean: vec![0.0; 3], spread: vec![spread; 3] },
            manners: Manners::default(),
            starts: vec![[1, 4], [3, 0]],
            style_starts: BTreeMap::new(),
            style_codes: BTreeMap::new(),
            critic: None,
        }
    }

    /// Whether a product of the exported graph has to find its range itself.
    fn looks(policy: &Policy, ranges: &InputRanges) -> bool {
        let graph = gpt_graph(&policy.weights(), WeightStorage::Int8, ranges).unwrap();
        graph.windows(9).any(|part| part == b"ReduceMax")
    }

    #[test]
    fn every_matrix_of_the_graph_has_its_range() {
        let mut config = config(std::path::Path::new(""));
        config.export.weights = WeightStorage::Int8;
        config.export.temperature = 1.0;
        let policy = policy(2.0);
        let ranges = input_ranges(&config, &policy);
        assert!(!looks(&policy, &ranges));
        assert!(looks(&policy, &InputRanges::default()));
        assert_eq!(ranges, input_ranges(&config, &policy));
    }

    #[test]
    fn there_are_none_where_none_are_wanted_or_noise_is_no_music() {
        let mut config = config(std::path::Path::new(""));
        assert_eq!(input_ranges(&config, &policy(2.0)), InputRanges::default());
        config.export.weights = WeightStorage::Int8;
        assert_eq!(input_ranges(&config, &policy(1.0)), InputRanges::default());
    }
}
