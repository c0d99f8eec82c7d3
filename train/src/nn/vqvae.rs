//! Encoder, decoder and half of the pose VQ-VAE (ARCHITECTURE section 2).

use bailando_kernels::{Kernels, Kind};
use burn_tensor::{Int, Tensor};

use super::{
    convolution::{ConvolutionNet, ResidualNet},
    parameters::{Parameters, Store},
};
use crate::weights::{
    DecoderLevel, DecoderWeights, EncoderLevel, EncoderWeights, HalfWeights, ResidualBlock,
};

/// Motion columns to embeddings.
#[derive(Clone, Debug)]
pub struct EncoderNet {
    levels: Vec<Level>,
    output: ConvolutionNet,
}

/// Embeddings to motion columns.
#[derive(Clone, Debug)]
pub struct DecoderNet {
    input: ConvolutionNet,
    levels: Vec<Level>,
    output: ConvolutionNet,
}

/// A change of the rate and a stack of residual blocks, in either order.
#[derive(Clone, Debug)]
struct Level {
    rate: ConvolutionNet,
    stack: Vec<ResidualNet>,
}

impl Level {
    fn stacked<B: Kernels>(&self, parameters: &Parameters<B>, input: Tensor<B, 3>) -> Tensor<B, 3> {
        let blocks = self.stack.iter();
        blocks.fold(input, |hidden, block| block.forward(parameters, hidden))
    }
}

impl EncoderNet {
    /// Plans the network and appends its weights to `store`.
    #[must_use]
    pub fn new(name: &str, weights: &EncoderWeights, store: &mut Store) -> Self {
        let levels = weights.levels.iter().enumerate();
        let levels = levels.map(|(index, level)| {
            let name = format!("{name}.levels.{index}");
            Level {
                rate: ConvolutionNet::new(
                    &format!("{name}.strided"),
                    Kind::Halving,
                    &level.strided,
                    store,
                ),
                stack: stack(&name, &level.stack, store),
            }
        });
        let levels = levels.collect();
        let name = format!("{name}.output");
        Self {
            levels,
            output: ConvolutionNet::new(&name, Kind::Dilated(1), &weights.output, store),
        }
    }

    /// Returns the weights in `store`.
    #[must_use]
    pub fn weights(&self, store: &Store) -> EncoderWeights {
        EncoderWeights {
            levels: self
                .levels
                .iter()
                .map(|level| EncoderLevel {
                    strided: level.rate.weights(store),
                    stack: stack_weights(&level.stack, store),
                })
                .collect(),
            output: self.output.weights(store),
        }
    }

    /// Encodes `[batch, frames, columns]` to `[batch, codes, embedding]`, 8 frames a code.
    pub fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        motion: Tensor<B, 3>,
    ) -> Tensor<B, 3> {
        let hidden = self.levels.iter().fold(motion, |hidden, level| {
            level.stacked(parameters, level.rate.forward(parameters, hidden))
        });
        self.output.forward(parameters, hidden)
    }
}

impl DecoderNet {
    /// Plans the network and appends its weights to `store`.
    #[must_use]
    pub fn new(name: &str, weights: &DecoderWeights, store: &mut Store) -> Self {
        let plain = Kind::Dilated(1);
        let input = ConvolutionNet::new(&format!("{name}.input"), plain, &weights.input, store);
        let levels = weights.levels.iter().enumerate();
        let levels = levels.map(|(index, level)| {
            let name = format!("{name}.levels.{index}");
            let stack = stack(&name, &level.stack, store);
            let name = format!("{name}.transposed");
            Level {
                rate: ConvolutionNet::new(&name, Kind::Doubling, &level.transposed, store),
                stack,
            }
        });
        let levels = levels.collect();
        let output = ConvolutionNet::new(&format!("{name}.output"), plain, &weights.output, store);
        Self { input, levels, output }
    }

    /// Returns the weights in `store`.
    #[must_use]
    pub fn weights(&self, store: &Store) -> DecoderWeights {
        DecoderWeights {
            input: self.input.weights(store),
            levels: self
                .levels
                .iter()
                .map(|level| DecoderLevel {
                    stack: stack_weights(&level.stack, store),
                    transposed: level.rate.weights(store),
                })
                .collect(),
            output: self.output.weights(store),
        }
    }

    /// Decodes `[batch, codes, embedding]` to `[batch, frames, columns]`.
    pub fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        embeddings: Tensor<B, 3>,
    ) -> Tensor<B, 3> {
        let hidden = self.input.forward(parameters, embeddings);
        let hidden = self.levels.iter().fold(hidden, |hidden, level| {
            let hidden = level.stacked(parameters, hidden);
            level.rate.forward(parameters, hidden)
        });
        self.output.forward(parameters, hidden)
    }
}

/// Encoder and decoder of one half; the codebook is learned by other means ([`super::Codebook`]).
#[derive(Clone, Debug)]
pub struct HalfNet {
    /// Motion to embeddings.
    pub encoder: EncoderNet,
    /// Embeddings to motion.
    pub decoder: DecoderNet,
}

impl HalfNet {
    /// Plans the networks and appends their weights to `store`.
    #[must_use]
    pub fn new(name: &str, weights: &HalfWeights, store: &mut Store) -> Self {
        Self {
            encoder: EncoderNet::new(&format!("{name}.encoder"), &weights.encoder, store),
            decoder: DecoderNet::new(&format!("{name}.decoder"), &weights.decoder, store),
        }
    }

    /// Returns the codes of `[batch, frames, columns]` motion, `[batch * codes]`.
    pub fn encode<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        codebook: &super::Codebook<B>,
        motion: Tensor<B, 3>,
    ) -> Tensor<B, 1, Int> {
        let embeddings = self.encoder.forward(parameters, motion);
        let [batch, codes, channels] = embeddings.dims();
        codebook.nearest(embeddings.reshape([batch * codes, channels]))
    }
}

fn stack(name: &str, blocks: &[ResidualBlock], store: &mut Store) -> Vec<ResidualNet> {
    let blocks = blocks.iter().enumerate();
    let blocks = blocks.map(|(index, block)| {
        let name = format!("{name}.stack.{index}");
        let kind = Kind::Dilated(block.dilation);
        ResidualNet {
            dilated: ConvolutionNet::new(&format!("{name}.dilated"), kind, &block.dilated, store),
            pointwise: ConvolutionNet::new(
                &format!("{name}.pointwise"),
                Kind::Pointwise,
                &block.pointwise,
                store,
            ),
            dilation: block.dilation,
        }
    });
    blocks.collect()
}

fn stack_weights(blocks: &[ResidualNet], store: &Store) -> Vec<ResidualBlock> {
    let blocks = blocks.iter();
    let blocks = blocks.map(|block| ResidualBlock {
        dilated: block.dilated.weights(store),
        dilation: block.dilation,
        pointwise: block.pointwise.weights(store),
    });
    blocks.collect()
}
