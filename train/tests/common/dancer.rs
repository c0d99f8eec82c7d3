//! The golden weights, widened by what the published model has not.

use bailando_train::{
    HostTensor,
    weights::{Convolution, GptWeights, VqVaeWeights},
};

use super::{gpt, vqvae};

/// A small number for a place, the same on every machine.
fn small(place: usize) -> f32 {
    ((place * 31) % 97) as f32 / 485.0 - 0.1
}

/// The golden VQ-VAE with a fourth row in the root's decoder, a turn to and fro.
pub(crate) fn turning() -> VqVaeWeights {
    let mut weights = vqvae();
    let Convolution { weight, bias } = &weights.root.output;
    let (mut values, mut offsets) = (weight.data().to_vec(), bias.data().to_vec());
    let row = values.len() / 3;
    values.extend((0..row).map(small));
    offsets.push(0.01);
    let shape = vec![4, weight.dim(1), weight.dim(2)];
    weights.root.output = Convolution {
        weight: HostTensor::new(shape, values).unwrap(),
        bias: HostTensor::new(vec![4], offsets).unwrap(),
    };
    weights
}

/// The golden GPT that is conditioned on so many periods of counts as well.
pub(crate) fn counting(periods: usize) -> GptWeights {
    widened(2 * periods, 1.0)
}

/// The golden GPT with so many columns more, whose weights are up to a tenth of `scale`.
pub(crate) fn widened(more: usize, scale: f32) -> GptWeights {
    let mut weights = gpt();
    let weight = &weights.music.weight;
    let (channels, columns) = (weight.dim(0), weight.dim(1));
    let mut values = Vec::new();
    for (channel, row) in weight.data().chunks(columns).enumerate() {
        values.extend(row);
        values.extend((0..more).map(|column| scale * small(7 * channel + column)));
    }
    let shape = vec![channels, columns + more];
    weights.music.weight = HostTensor::new(shape, values).unwrap();
    weights
}
