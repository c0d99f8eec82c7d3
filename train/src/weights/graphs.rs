//! Weights out of the graphs of a model directory, by the names that `onnx` gives them.

use super::{
    Block, DecoderLevel, DecoderWeights, GptWeights, HALF_JOINTS, LayerNorm, Linear, ResidualBlock,
    WeightError,
    gpt::{STREAMS, check_heads},
    source::{
        Size::{self, Any, Between, Is},
        Source, Tensors,
    },
    vqvae::{ConvolutionShape, Dilations, KERNEL, MAX_LEVELS, convolution, transposed},
};
use crate::{HostTensor, checkpoint::CheckpointError};

/// What turns codes into motion.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionWeights {
    /// Codebooks of the upper and the lower half, `[codes, embedding]`.
    pub codebooks: [HostTensor; 2],
    /// Decoders of the upper and the lower half.
    pub halves: [DecoderWeights; 2],
    /// The root's velocity; none where the lower half gives the root's columns.
    pub root: Option<DecoderWeights>,
}

impl MotionWeights {
    /// Takes the weights out of `decoder.onnx`.
    pub(crate) fn from_graph(graph: &mut dyn Tensors) -> Result<Self, WeightError> {
        let mut source = Source::new(graph);
        let mut codebook = |half: &str| {
            source.take(&format!("{half}.codebook"), &[Any("codes"), Any("embedding")])
        };
        let codebooks = [codebook("upper")?, codebook("lower")?];
        let [upper, lower] = codebooks.each_ref().map(|codebook| codebook.dim(1));
        let [above, below] = [HALF_JOINTS.0.len(), HALF_JOINTS.1.len()];
        let halves = [
            decoder(&mut source, "upper", upper, Is(3 * above))?,
            decoder(&mut source, "lower", lower, Is(3 * below))?,
        ];
        let root = Some(decoder(&mut source, "root", lower, Between(3, 4))?);
        Ok(Self { codebooks, halves, root })
    }
}

impl GptWeights {
    /// Takes the weights out of `gpt.onnx`.
    pub(crate) fn from_graph(graph: &mut dyn Tensors, heads: usize) -> Result<Self, WeightError> {
        let mut source = Source::new(graph);
        let table = [Any("vocabulary"), Any("channels")];
        let upper_embedding = source.take("upper_embedding", &table)?;
        let channels = upper_embedding.dim(1);
        check_heads(&source, channels, heads)?;
        let lower_embedding = source.take("lower_embedding", &[Any("vocabulary"), Is(channels)])?;
        let mut head = |half: &str, embedding: &HostTensor| {
            let shape = [Is(channels), Is(embedding.dim(0))];
            Ok::<_, CheckpointError>(source.take(&format!("{half}_head"), &shape)?.transposed())
        };
        let upper_head = head("upper", &upper_embedding)?;
        let lower_head = head("lower", &lower_embedding)?;
        let count = source.count(|layer| format!("blocks.{layer}.attention_norm.bias"));
        let layers = 0..count.max(1);
        let blocks = layers.map(|layer| block(&mut source, &format!("blocks.{layer}"), channels));
        Ok(Self {
            blocks: blocks.collect::<Result<_, _>>()?,
            positions: positions(&mut source, channels)?,
            music: linear(&mut source, "music", Any("columns"), channels)?,
            final_norm: layer_norm(&mut source, "final_norm", channels)?,
            upper_head,
            lower_head,
            upper_embedding,
            lower_embedding,
            heads,
        })
    }
}

/// The positions of music, upper and lower codes as one table.
fn positions(source: &mut Source<'_>, channels: usize) -> Result<HostTensor, CheckpointError> {
    let mut tables: Vec<HostTensor> = Vec::with_capacity(STREAMS);
    for stream in ["music", "upper", "lower"] {
        let block = tables.first().map_or(Any("block"), |first| Is(first.dim(0)));
        tables.push(source.take(&format!("{stream}_positions"), &[block, Is(channels)])?);
    }
    Ok(HostTensor::stacked(&tables.iter().collect::<Vec<_>>()))
}

fn block(source: &mut Source<'_>, name: &str, channels: usize) -> Result<Block, CheckpointError> {
    let mut own = |part: &str, inputs: Size, outputs: usize| {
        linear(source, &format!("{name}.{part}"), inputs, outputs)
    };
    let fused = own("query_key_value", Is(channels), 3 * channels)?;
    let third = |third: usize| {
        let rows = |tensor: &HostTensor| tensor.rows(third * channels, (third + 1) * channels);
        Linear { weight: rows(&fused.weight), bias: rows(&fused.bias) }
    };
    let projection = own("projection", Is(channels), channels)?;
    let mlp_out = own("mlp_out", Any("hidden"), channels)?;
    let mlp_in = own("mlp_in", Is(channels), mlp_out.weight.dim(1))?;
    Ok(Block {
        query: third(0),
        key: third(1),
        value: third(2),
        projection,
        mlp_in,
        mlp_out,
        attention_norm: layer_norm(source, &format!("{name}.attention_norm"), channels)?,
        mlp_norm: layer_norm(source, &format!("{name}.mlp_norm"), channels)?,
    })
}

/// Graphs multiply from the left: their matrices are `[inputs, outputs]`.
fn linear(
    source: &mut Source<'_>,
    name: &str,
    inputs: Size,
    outputs: usize,
) -> Result<Linear, CheckpointError> {
    let weight = source.take(&format!("{name}.weight"), &[inputs, Is(outputs)])?.transposed();
    Ok(Linear { weight, bias: source.take(&format!("{name}.bias"), &[Is(outputs)])? })
}

fn layer_norm(
    source: &mut Source<'_>,
    name: &str,
    channels: usize,
) -> Result<LayerNorm, CheckpointError> {
    let mut own = |part: &str| source.take(&format!("{name}.{part}"), &[Is(channels)]);
    Ok(LayerNorm { weight: own("weight")?, bias: own("bias")? })
}

fn decoder(
    source: &mut Source<'_>,
    name: &str,
    embedding: usize,
    columns: Size,
) -> Result<DecoderWeights, CheckpointError> {
    let shape = ConvolutionShape::new(Any("width"), Is(embedding), KERNEL);
    let input = convolution(source, &format!("{name}.input"), shape)?;
    let mut width = input.weight.dim(0);
    let count = source.count(|level| format!("{name}.levels.{level}.transposed.bias"));
    let mut levels = Vec::new();
    for level in 0..count.clamp(1, MAX_LEVELS) {
        let name = format!("{name}.levels.{level}");
        let stack = stack(source, &name, width, Dilations::Descending)?;
        let transposed = transposed(source, &format!("{name}.transposed"), width)?;
        width = transposed.weight.dim(1);
        levels.push(DecoderLevel { stack, transposed });
    }
    let shape = ConvolutionShape::new(columns, Is(width), KERNEL);
    let output = convolution(source, &format!("{name}.output"), shape)?;
    Ok(DecoderWeights { input, levels, output })
}

pub(super) fn stack(
    source: &mut Source<'_>,
    name: &str,
    width: usize,
    dilations: Dilations,
) -> Result<Vec<ResidualBlock>, CheckpointError> {
    let depth = source.count(|place| format!("{name}.stack.{place}.dilated.bias")).max(1);
    let block = |place: usize| {
        let name = format!("{name}.stack.{place}");
        let shape = ConvolutionShape::new(Any("width"), Is(width), KERNEL);
        let dilated = convolution(source, &format!("{name}.dilated"), shape)?;
        let shape = ConvolutionShape::new(Is(width), Is(dilated.weight.dim(0)), 1);
        Ok(ResidualBlock {
            pointwise: convolution(source, &format!("{name}.pointwise"), shape)?,
            dilation: dilations.of(place, depth),
            dilated,
        })
    };
    (0..depth).map(block).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use bailando::model::WeightStorage;

    use super::*;
    use crate::{
        nn::{GptSizes, VqVaeSizes, random_gpt, random_vqvae},
        onnx::{GraphWeights, InputRanges, decoder_graph, gpt_graph},
    };

    fn gpt() -> GptWeights {
        let sizes =
            GptSizes { channels: 8, heads: 2, layers: 2, block: 6, codes: [5, 4], columns: 3 };
        random_gpt(sizes, 7)
    }

    fn read(bytes: &[u8]) -> GraphWeights {
        GraphWeights::from_bytes(Path::new("model.onnx"), bytes).unwrap()
    }

    #[test]
    fn weights_come_back_as_they_were_written() {
        let (weights, ranges) = (gpt(), InputRanges::default());
        let graph = gpt_graph(&weights, WeightStorage::F32, &ranges).unwrap();
        assert_eq!(GptWeights::from_graph(&mut read(&graph), 2).unwrap(), weights);

        let sizes = VqVaeSizes {
            half_columns: [45, 27],
            width: 6,
            embedding: 4,
            codes: 5,
            root_columns: 4,
        };
        let weights = random_vqvae(sizes, 7);
        let graph = decoder_graph(&weights, WeightStorage::F32).unwrap();
        let found = MotionWeights::from_graph(&mut read(&graph)).unwrap();
        assert_eq!(found.root, Some(weights.root));
        for (half, written) in [weights.upper, weights.lower].into_iter().enumerate() {
            assert_eq!(found.halves[half], written.decoder);
            assert_eq!(found.codebooks[half], written.codebook);
        }
    }

    /// Nothing is lost by taking weights of 8 bits and their ranges out and writing them again.
    #[test]
    fn a_quantised_graph_is_written_again_as_it_was() {
        let names = ["query_key_value", "projection", "mlp_in", "mlp_out"];
        let names =
            (0..2).flat_map(|layer| names.map(|name| format!("blocks.{layer}.{name}.weight")));
        let names = names.chain(["upper_head", "lower_head"].map(str::to_owned));
        let ranges: InputRanges = names.map(|name| (name, [-0.75, 1.8])).collect();
        let graph = gpt_graph(&gpt(), WeightStorage::Int8, &ranges).unwrap();
        let mut read = read(&graph);
        let weights = GptWeights::from_graph(&mut read, 2).unwrap();
        let again = gpt_graph(&weights, WeightStorage::Int8, &read.input_ranges()).unwrap();
        let mut again = self::read(&again);
        let found = GptWeights::from_graph(&mut again, 2).unwrap();
        assert_eq!(again.input_ranges(), read.input_ranges());
        let unknown = gpt_graph(&weights, WeightStorage::Int8, &InputRanges::default()).unwrap();
        assert_eq!(self::read(&unknown).input_ranges(), InputRanges::default());
        for (found, written) in found.blocks.iter().zip(&weights.blocks) {
            let pairs = found.mlp_in.weight.data().iter().zip(written.mlp_in.weight.data());
            pairs.for_each(|(found, written)| assert!((found - written).abs() < 1e-6));
        }
    }

    #[test]
    fn a_graph_of_other_weights_is_refused_by_the_tensor_that_it_lacks() {
        let graph = gpt_graph(&gpt(), WeightStorage::F16, &InputRanges::default()).unwrap();
        let error = MotionWeights::from_graph(&mut read(&graph)).unwrap_err();
        assert_eq!(error.to_string(), "model.onnx: tensor `upper.codebook` is missing");
        let error = GptWeights::from_graph(&mut read(&graph), 3).unwrap_err();
        assert!(error.to_string().contains("8 channels cannot be divided among 3 heads"));
        let error = GraphWeights::from_bytes(Path::new("x.onnx"), b"\x08\x01\xff").unwrap_err();
        assert!(
            error.to_string().starts_with("x.onnx: it is no graph of a model directory"),
            "{error}"
        );
    }
}
