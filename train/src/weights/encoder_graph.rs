//! The pose VQ-VAE's encoders out of the graph of a model directory.

use super::{
    Convolution, EncoderLevel, EncoderWeights, HALF_JOINTS, WeightError,
    graphs::stack,
    source::{
        Size::{Any, Is},
        Source, Tensors,
    },
    vqvae::{ConvolutionShape, Dilations, KERNEL, MAX_LEVELS, STRIDED_KERNEL, convolution},
};
use crate::{HostTensor, checkpoint::CheckpointError};

/// Coordinates of a joint.
const COORDINATES: usize = 3;

/// Takes the encoders of both halves out of `encoder.onnx`; `codebooks` are those of
/// `decoder.onnx`.
pub(crate) fn encoders_from_graph(
    encoder: &mut dyn Tensors,
    codebooks: &[HostTensor; 2],
) -> Result<[EncoderWeights; 2], WeightError> {
    let mut source = Source::new(encoder);
    let [upper, lower] = codebooks;
    Ok([
        half_encoder(&mut source, "upper", upper, &HALF_JOINTS.0)?,
        half_encoder(&mut source, "lower", lower, &HALF_JOINTS.1)?,
    ])
}

fn half_encoder(
    source: &mut Source<'_>,
    name: &str,
    codebook: &HostTensor,
    joints: &[usize],
) -> Result<EncoderWeights, CheckpointError> {
    // The root is always zero, and its columns are left out of the graph.
    let still = COORDINATES * joints.iter().filter(|&&joint| joint == 0).count();
    let mut width = COORDINATES * joints.len() - still;
    let count = source.count(|level| format!("{name}.levels.{level}.strided.bias"));
    let mut levels = Vec::new();
    for level in 0..count.clamp(1, MAX_LEVELS) {
        let name = format!("{name}.levels.{level}");
        let shape = ConvolutionShape::new(Any("width"), Is(width), STRIDED_KERNEL);
        let strided = convolution(source, &format!("{name}.strided"), shape)?;
        width = strided.weight.dim(0);
        let strided = if level == 0 { with_still_inputs(&strided, still) } else { strided };
        levels.push(EncoderLevel {
            strided,
            stack: stack(source, &name, width, Dilations::Ascending)?,
        });
    }
    let shape = ConvolutionShape::new(Is(codebook.dim(1)), Is(width), KERNEL);
    Ok(EncoderWeights { levels, output: convolution(source, &format!("{name}.output"), shape)? })
}

/// The convolution with `count` leading inputs more, which count for nothing.
fn with_still_inputs(convolution: &Convolution, count: usize) -> Convolution {
    let weight = &convolution.weight;
    let (outputs, inputs, kernel) = (weight.dim(0), weight.dim(1), weight.dim(2));
    let row = (count + inputs) * kernel;
    let value = |flat: usize| {
        let (output, place) = (flat / row, flat % row);
        let place = place.checked_sub(count * kernel);
        place.map_or(0.0, |place| weight.data()[output * inputs * kernel + place])
    };
    Convolution {
        weight: HostTensor::from_fn(vec![outputs, count + inputs, kernel], value),
        bias: convolution.bias.clone(),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use bailando::model::WeightStorage;

    use super::*;
    use crate::{
        nn::{VqVaeSizes, random_vqvae},
        onnx::{GraphWeights, encoder_graph},
    };

    #[test]
    fn encoders_come_back_as_they_were_written_but_for_still_inputs() {
        let sizes = VqVaeSizes {
            half_columns: [45, 27],
            width: 6,
            embedding: 4,
            codes: 5,
            root_columns: 4,
        };
        let written = random_vqvae(sizes, 7);
        let graph = encoder_graph(&written, WeightStorage::F32).unwrap();
        let mut graph = GraphWeights::from_bytes(Path::new("model.onnx"), &graph).unwrap();
        let codebooks = [written.upper.codebook.clone(), written.lower.codebook.clone()];
        let [upper, mut lower] = encoders_from_graph(&mut graph, &codebooks).unwrap();
        assert_eq!(upper, written.upper.encoder);

        let strided = &written.lower.encoder.levels[0].strided.weight;
        let read = &mut lower.levels[0].strided.weight;
        assert_eq!(read.shape(), strided.shape());
        let row = strided.dim(1) * strided.dim(2);
        for (flat, (&found, &written)) in read.data().iter().zip(strided.data()).enumerate() {
            let still = flat % row < COORDINATES * strided.dim(2);
            assert_eq!(found, if still { 0.0 } else { written });
        }
        *read = strided.clone();
        assert_eq!(lower, written.lower.encoder);
    }
}
