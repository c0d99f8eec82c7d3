//! Writes a model directory of the published size with random weights, to measure speed and memory
//! where the published weights are not at hand. Its dances are noise.
//!
//! `cargo run --release -p bailando-train --example random_model -- OUT [f32|f16|int8]`

use std::{collections::BTreeMap, path::Path};

use anyhow::Context;
use bailando::{
    features::Profile,
    model::{SuppressedCodes, WeightStorage},
    motion::MotionFrame,
};
use bailando_train::{
    HostTensor,
    export::{Description, PUBLISHED_HOP, write_model_directory},
    onnx::InputRanges,
    weights::{
        Block, Convolution, DecoderLevel, DecoderWeights, EncoderLevel, EncoderWeights, GptWeights,
        HALF_JOINTS, HalfWeights, LayerNorm, Linear, ResidualBlock, VqVaeWeights,
    },
};

// ARCHITECTURE sections 2 and 3.
const CHANNELS: usize = 768;
const HEADS: usize = 12;
const LAYERS: usize = 6 + 6;
const BLOCK: usize = 29;
const COLUMNS: usize = 438;
const CODES: usize = 512;
const WIDTH: usize = 512;
const LEVELS: usize = 3;
const DILATIONS: [usize; 3] = [1, 3, 9];

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: random_model OUT [f32|f16|int8]";
    let out = arguments.next().context(usage)?;
    let weights = match arguments.next().as_deref() {
        None | Some("f32") => WeightStorage::F32,
        Some("f16") => WeightStorage::F16,
        Some("int8") => WeightStorage::Int8,
        Some(_) => anyhow::bail!(usage),
    };
    let mut noise = Noise(0x9e37_79b9_7f4a_7c15);
    let (gpt, vqvae) = (gpt(&mut noise)?, vqvae(&mut noise)?);
    let description = Description {
        name: "random-published-size".into(),
        licence: "MIT".into(),
        profile: Profile::Librosa011,
        count_periods: Vec::new(),
        start_codes: Vec::new(),
        suppressed_codes: SuppressedCodes::default(),
        temperature: 1.0,
        guidance: 1.0,
        candidates: 1,
        redo: false,
        hop: PUBLISHED_HOP,
        motion_frame: MotionFrame::World,
        root_height: 0.93,
        weights,
        training: BTreeMap::new(),
    };
    let ranges = InputRanges::default();
    write_model_directory(Path::new(&out), false, &gpt, &ranges, &vqvae, &description)?;
    Ok(())
}

/// An xorshift generator: the same weights on every machine.
struct Noise(u64);

impl Noise {
    /// Uniform in -1..1.
    fn next(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 40) as f32 / (1 << 23) as f32 - 1.0
    }

    /// Values within `scale` of zero.
    fn tensor(&mut self, shape: &[usize], scale: f32) -> anyhow::Result<HostTensor> {
        let count = shape.iter().product();
        let data = (0..count).map(|_| scale * self.next()).collect();
        Ok(HostTensor::new(shape.to_vec(), data)?)
    }

    /// Small enough to keep activations bounded: variance one over the number of inputs.
    fn linear(&mut self, outputs: usize, inputs: usize) -> anyhow::Result<Linear> {
        Ok(Linear {
            weight: self.tensor(&[outputs, inputs], (3.0 / inputs as f32).sqrt())?,
            bias: self.tensor(&[outputs], 0.01)?,
        })
    }

    fn convolution(
        &mut self,
        outputs: usize,
        inputs: usize,
        kernel: usize,
    ) -> anyhow::Result<Convolution> {
        Ok(Convolution {
            weight: self.tensor(
                &[outputs, inputs, kernel],
                (1.0 / (inputs * kernel) as f32).sqrt(),
            )?,
            bias: self.tensor(&[outputs], 0.01)?,
        })
    }
}

fn layer_norm() -> anyhow::Result<LayerNorm> {
    Ok(LayerNorm {
        weight: HostTensor::new(vec![CHANNELS], vec![1.0; CHANNELS])?,
        bias: HostTensor::new(vec![CHANNELS], vec![0.0; CHANNELS])?,
    })
}

fn block(noise: &mut Noise) -> anyhow::Result<Block> {
    Ok(Block {
        attention_norm: layer_norm()?,
        query: noise.linear(CHANNELS, CHANNELS)?,
        key: noise.linear(CHANNELS, CHANNELS)?,
        value: noise.linear(CHANNELS, CHANNELS)?,
        projection: noise.linear(CHANNELS, CHANNELS)?,
        mlp_norm: layer_norm()?,
        mlp_in: noise.linear(4 * CHANNELS, CHANNELS)?,
        mlp_out: noise.linear(CHANNELS, 4 * CHANNELS)?,
    })
}

fn gpt(noise: &mut Noise) -> anyhow::Result<GptWeights> {
    Ok(GptWeights {
        music: noise.linear(CHANNELS, COLUMNS)?,
        upper_embedding: noise.tensor(&[CODES, CHANNELS], 1.0)?,
        lower_embedding: noise.tensor(&[CODES, CHANNELS], 1.0)?,
        positions: noise.tensor(&[3 * BLOCK, CHANNELS], 1.0)?,
        blocks: (0..LAYERS)
            .map(|_| block(noise))
            .collect::<Result<_, _>>()?,
        final_norm: layer_norm()?,
        upper_head: noise.tensor(&[CODES, CHANNELS], 0.06)?,
        lower_head: noise.tensor(&[CODES, CHANNELS], 0.06)?,
        heads: HEADS,
    })
}

fn stack(
    noise: &mut Noise,
    dilations: impl Iterator<Item = usize>,
) -> anyhow::Result<Vec<ResidualBlock>> {
    dilations
        .map(|dilation| {
            Ok(ResidualBlock {
                dilated: noise.convolution(WIDTH, WIDTH, 3)?,
                dilation,
                pointwise: noise.convolution(WIDTH, WIDTH, 1)?,
            })
        })
        .collect()
}

fn encoder(noise: &mut Noise, columns: usize) -> anyhow::Result<EncoderWeights> {
    let levels = (0..LEVELS).map(|level| {
        let inputs = if level == 0 { columns } else { WIDTH };
        Ok(EncoderLevel {
            strided: noise.convolution(WIDTH, inputs, 4)?,
            stack: stack(noise, DILATIONS.into_iter())?,
        })
    });
    Ok(EncoderWeights {
        levels: levels.collect::<anyhow::Result<_>>()?,
        output: noise.convolution(WIDTH, WIDTH, 3)?,
    })
}

fn decoder(noise: &mut Noise, columns: usize) -> anyhow::Result<DecoderWeights> {
    let input = noise.convolution(WIDTH, WIDTH, 3)?;
    let levels = (0..LEVELS).map(|_| {
        Ok(DecoderLevel {
            stack: stack(noise, DILATIONS.into_iter().rev())?,
            transposed: noise.convolution(WIDTH, WIDTH, 4)?,
        })
    });
    Ok(DecoderWeights {
        input,
        levels: levels.collect::<anyhow::Result<_>>()?,
        output: noise.convolution(columns, WIDTH, 3)?,
    })
}

fn half(noise: &mut Noise, joints: usize) -> anyhow::Result<HalfWeights> {
    Ok(HalfWeights {
        encoder: encoder(noise, 3 * joints)?,
        codebook: noise.tensor(&[CODES, WIDTH], 1.0)?,
        decoder: decoder(noise, 3 * joints)?,
    })
}

fn vqvae(noise: &mut Noise) -> anyhow::Result<VqVaeWeights> {
    let (upper, lower) = HALF_JOINTS;
    Ok(VqVaeWeights {
        upper: half(noise, upper.len())?,
        lower: half(noise, lower.len())?,
        root: decoder(noise, 3)?,
    })
}
