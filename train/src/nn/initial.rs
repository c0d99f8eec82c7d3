//! Random weights to start from: the distributions of the published training program's framework.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{
    HostTensor,
    weights::{
        Block, Convolution, CriticWeights, DecoderLevel, DecoderWeights, EncoderLevel,
        EncoderWeights, GptWeights, HalfWeights, LayerNorm, Linear, ResidualBlock, VqVaeWeights,
    },
};

/// Halvings of the encoder: 8 frames are a code.
const LEVELS: usize = 3;
/// Dilations of a stack (ARCHITECTURE section 2).
const DILATIONS: [usize; 3] = [1, 3, 9];
/// Spread of the GPT's random matrices.
const GPT_SPREAD: f64 = 0.02;

/// Sizes of a pose VQ-VAE.
#[derive(Clone, Copy, Debug)]
pub struct VqVaeSizes {
    /// Channels of the convolutions.
    pub width: usize,
    /// Channels of a codebook entry.
    pub embedding: usize,
    /// Codebook entries of each half.
    pub codes: usize,
    /// Columns of each half.
    pub half_columns: [usize; 2],
    /// Columns of the root's decoder: 3, or 4 in the dancer's frame.
    pub root_columns: usize,
}

/// Sizes of a motion GPT.
#[derive(Clone, Copy, Debug)]
pub struct GptSizes {
    /// Embedding width.
    pub channels: usize,
    /// Attention heads.
    pub heads: usize,
    /// Blocks, state network and policy together.
    pub layers: usize,
    /// Longest history in steps.
    pub block: usize,
    /// Upper and lower codes.
    pub codes: [usize; 2],
    /// Values per music row.
    pub columns: usize,
}

/// A pose VQ-VAE with random convolutions; its codebooks are zero until the first batch.
#[must_use]
pub fn random_vqvae(sizes: VqVaeSizes, seed: u64) -> VqVaeWeights {
    let mut random = Random::new(seed);
    let [upper, lower] = sizes.half_columns;
    VqVaeWeights {
        upper: half(sizes, upper, &mut random),
        lower: half(sizes, lower, &mut random),
        root: decoder(sizes, sizes.root_columns, &mut random),
    }
}

/// A motion GPT with random weights; positions and offsets are zero.
#[must_use]
pub fn random_gpt(sizes: GptSizes, seed: u64) -> GptWeights {
    let mut random = Random::new(seed);
    let GptSizes { channels, .. } = sizes;
    let [upper, lower] = sizes.codes;
    GptWeights {
        music: random.linear(channels, sizes.columns),
        upper_embedding: random.normal(vec![upper, channels]),
        lower_embedding: random.normal(vec![lower, channels]),
        positions: filled(vec![3 * sizes.block, channels], 0.0),
        blocks: (0..sizes.layers).map(|_| block(channels, &mut random)).collect(),
        final_norm: norm(channels),
        upper_head: random.normal(vec![upper, channels]),
        lower_head: random.normal(vec![lower, channels]),
        heads: sizes.heads,
    }
}

/// A critic of `layers` blocks with random weights, for states of `channels`.
#[must_use]
pub fn random_critic(channels: usize, heads: usize, layers: usize, seed: u64) -> CriticWeights {
    let mut random = Random::new(seed);
    CriticWeights {
        blocks: (0..layers).map(|_| block(channels, &mut random)).collect(),
        final_norm: norm(channels),
        upper_value: random.normal(vec![1, channels]),
        lower_value: random.normal(vec![1, channels]),
        heads,
    }
}

fn half(sizes: VqVaeSizes, columns: usize, random: &mut Random) -> HalfWeights {
    HalfWeights {
        encoder: encoder(sizes, columns, random),
        codebook: filled(vec![sizes.codes, sizes.embedding], 0.0),
        decoder: decoder(sizes, columns, random),
    }
}

fn encoder(sizes: VqVaeSizes, columns: usize, random: &mut Random) -> EncoderWeights {
    let width = sizes.width;
    let levels = (0..LEVELS).map(|level| EncoderLevel {
        strided: random.convolution(width, if level == 0 { columns } else { width }, 4),
        stack: stack(width, DILATIONS, random),
    });
    EncoderWeights {
        levels: levels.collect(),
        output: random.convolution(sizes.embedding, width, 3),
    }
}

fn decoder(sizes: VqVaeSizes, columns: usize, random: &mut Random) -> DecoderWeights {
    let width = sizes.width;
    let [first, second, third] = DILATIONS;
    let input = random.convolution(width, sizes.embedding, 3);
    let levels = (0..LEVELS).map(|_| DecoderLevel {
        stack: stack(width, [third, second, first], random),
        transposed: random.transposed(width),
    });
    DecoderWeights {
        input,
        levels: levels.collect(),
        output: random.convolution(columns, width, 3),
    }
}

fn stack(width: usize, dilations: [usize; 3], random: &mut Random) -> Vec<ResidualBlock> {
    let blocks = dilations.into_iter().map(|dilation| ResidualBlock {
        dilated: random.convolution(width, width, 3),
        dilation,
        pointwise: random.convolution(width, width, 1),
    });
    blocks.collect()
}

fn block(channels: usize, random: &mut Random) -> Block {
    Block {
        attention_norm: norm(channels),
        query: random.linear(channels, channels),
        key: random.linear(channels, channels),
        value: random.linear(channels, channels),
        projection: random.linear(channels, channels),
        mlp_norm: norm(channels),
        mlp_in: random.linear(4 * channels, channels),
        mlp_out: random.linear(channels, 4 * channels),
    }
}

fn norm(channels: usize) -> LayerNorm {
    LayerNorm { weight: filled(vec![channels], 1.0), bias: filled(vec![channels], 0.0) }
}

fn filled(shape: Vec<usize>, value: f32) -> HostTensor {
    HostTensor::from_fn(shape, |_| value)
}

struct Random(ChaCha8Rng);

impl Random {
    fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// In `[0, 1)`.
    fn unit(&mut self) -> f64 {
        self.0.random()
    }

    fn uniform(&mut self, shape: Vec<usize>, bound: f64) -> HostTensor {
        HostTensor::from_fn(shape, |_| ((2.0 * self.unit() - 1.0) * bound) as f32)
    }

    /// Box and Muller's transform.
    fn normal(&mut self, shape: Vec<usize>) -> HostTensor {
        HostTensor::from_fn(shape, |_| {
            let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
            let angle = std::f64::consts::TAU * self.unit();
            (GPT_SPREAD * radius * angle.cos()) as f32
        })
    }

    fn linear(&mut self, outputs: usize, inputs: usize) -> Linear {
        Linear { weight: self.normal(vec![outputs, inputs]), bias: filled(vec![outputs], 0.0) }
    }

    /// Uniform within `1 / sqrt(inputs of an output)`.
    fn convolution(&mut self, outputs: usize, inputs: usize, kernel: usize) -> Convolution {
        let bound = 1.0 / ((inputs * kernel) as f64).sqrt();
        Convolution {
            weight: self.uniform(vec![outputs, inputs, kernel], bound),
            bias: self.uniform(vec![outputs], bound),
        }
    }

    fn transposed(&mut self, width: usize) -> Convolution {
        self.convolution(width, width, 4)
    }
}
