//! The pose VQ-VAE (ARCHITECTURE section 2): encoder, codebook and decoder of each half, and the
//! decoder of the root's velocity.

use super::{
    WeightError,
    source::{
        Size::{self, Any, Between, Is},
        Source,
    },
};
use crate::{HostTensor, checkpoint::CheckpointError, checkpoint::TorchCheckpoint};

/// SMPL joints of the upper and of the lower half (ARCHITECTURE section 1).
pub const HALF_JOINTS: ([usize; 15], [usize; 9]) =
    ([3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23], [0, 1, 2, 4, 5, 7, 8, 10, 11]);
/// Kernel of every strided and transposed convolution.
pub(super) const STRIDED_KERNEL: usize = 4;
/// Kernel of the plain and of the dilated convolutions.
pub(super) const KERNEL: usize = 3;
/// A code of more than 256 frames (over four seconds) is no pose code.
pub(super) const MAX_LEVELS: usize = 8;
/// Dilations grow by this factor from block to block of a stack.
const DILATION_GROWTH: usize = 3;

/// A convolution along time.
#[derive(Clone, Debug, PartialEq)]
pub struct Convolution {
    /// `[out, in, kernel]`; [in, out, kernel] where it is transposed.
    pub weight: HostTensor,
    /// `[out]`.
    pub bias: HostTensor,
}

/// `x + pointwise(relu(dilated(relu(x))))`.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidualBlock {
    /// Kernel 3.
    pub dilated: Convolution,
    /// Dilation and padding of `dilated`.
    pub dilation: usize,
    /// Kernel 1.
    pub pointwise: Convolution,
}

/// One halving of the encoder: a strided convolution, then a stack.
#[derive(Clone, Debug, PartialEq)]
pub struct EncoderLevel {
    /// Kernel 4, stride 2, padding 1.
    pub strided: Convolution,
    /// Dilations ascending.
    pub stack: Vec<ResidualBlock>,
}

/// Motion columns to embeddings.
#[derive(Clone, Debug, PartialEq)]
pub struct EncoderWeights {
    /// Each halves the length.
    pub levels: Vec<EncoderLevel>,
    /// Kernel 3, to the embedding's width.
    pub output: Convolution,
}

/// One doubling of the decoder: a stack, then a transposed convolution.
#[derive(Clone, Debug, PartialEq)]
pub struct DecoderLevel {
    /// Dilations descending.
    pub stack: Vec<ResidualBlock>,
    /// Kernel 4, stride 2, padding 1, weight `[in, out, 4]`.
    pub transposed: Convolution,
}

/// Embeddings to motion columns.
#[derive(Clone, Debug, PartialEq)]
pub struct DecoderWeights {
    /// Kernel 3, from the embedding's width.
    pub input: Convolution,
    /// Each doubles the length.
    pub levels: Vec<DecoderLevel>,
    /// Kernel 3, to the columns.
    pub output: Convolution,
}

/// One half body.
#[derive(Clone, Debug, PartialEq)]
pub struct HalfWeights {
    /// Motion to embeddings.
    pub encoder: EncoderWeights,
    /// `[codes, embedding]`.
    pub codebook: HostTensor,
    /// Embeddings to motion.
    pub decoder: DecoderWeights,
}

/// Weights of the pose VQ-VAE.
#[derive(Clone, Debug, PartialEq)]
pub struct VqVaeWeights {
    /// Upper half body.
    pub upper: HalfWeights,
    /// Lower half body.
    pub lower: HalfWeights,
    /// From the lower half's embeddings to the root's velocity, three columns; a fourth, where the
    /// model works in the dancer's frame, is the turn to the next frame.
    pub root: DecoderWeights,
}

impl VqVaeWeights {
    /// Takes the weights out of an official checkpoint.
    ///
    /// # Errors
    /// [`WeightError`] names the first tensor that is missing or does not fit the others.
    pub fn from_checkpoint(checkpoint: &mut TorchCheckpoint) -> Result<Self, WeightError> {
        let mut source = Source::new(checkpoint);
        let (upper_joints, lower_joints) = HALF_JOINTS;
        let upper = half(&mut source, "vqvae_up", 3 * upper_joints.len(), None)?;
        let levels = upper.encoder.levels.len();
        let lower = half(&mut source, "vqvae_down", 3 * lower_joints.len(), Some(levels))?;
        let root = decoder(
            &mut source,
            "vqvae_down.decoders_root.0",
            DecoderSizes { columns: Between(3, 4), embedding: lower.codebook.dim(1), levels },
        )?;
        Ok(Self { upper, lower, root })
    }

    /// Motion frames that one code stands for.
    #[must_use]
    pub fn frames_per_code(&self) -> usize {
        1 << self.upper.encoder.levels.len()
    }

    /// Columns that the root's decoder gives.
    #[must_use]
    pub fn root_columns(&self) -> usize {
        self.root.output.weight.dim(0)
    }

    /// Channels of the convolutions.
    #[must_use]
    pub fn width(&self) -> usize {
        self.upper.decoder.input.weight.dim(0)
    }
}

fn half(
    source: &mut Source<'_>,
    name: &str,
    columns: usize,
    levels: Option<usize>,
) -> Result<HalfWeights, CheckpointError> {
    let codebook = source
        .take(&format!("{name}.bottleneck.level_blocks.0.k"), &[Any("codes"), Any("embedding")])?;
    let embedding = codebook.dim(1);
    let encoder = encoder(source, &format!("{name}.encoders.0"), columns, embedding, levels)?;
    let sizes = DecoderSizes { columns: Is(columns), embedding, levels: encoder.levels.len() };
    Ok(HalfWeights {
        decoder: decoder(source, &format!("{name}.decoders.0"), sizes)?,
        encoder,
        codebook,
    })
}

fn encoder(
    source: &mut Source<'_>,
    name: &str,
    columns: usize,
    embedding: usize,
    levels: Option<usize>,
) -> Result<EncoderWeights, CheckpointError> {
    let name = format!("{name}.level_blocks.0.model");
    // Beyond the bound, the output convolution will not be where it is expected: an error as well.
    let count = source.count(|level| format!("{name}.{level}.0.weight")).clamp(1, MAX_LEVELS);
    let count = levels.unwrap_or(count);
    let mut width = columns;
    let mut levels = Vec::with_capacity(count);
    for level in 0..count {
        let shape = ConvolutionShape::new(Any("width"), Is(width), STRIDED_KERNEL);
        let strided = convolution(source, &format!("{name}.{level}.0"), shape)?;
        width = strided.weight.dim(0);
        levels.push(EncoderLevel {
            strided,
            stack: stack(source, &format!("{name}.{level}.1"), width, Dilations::Ascending)?,
        });
    }
    let shape = ConvolutionShape::new(Is(embedding), Is(width), KERNEL);
    Ok(EncoderWeights { levels, output: convolution(source, &format!("{name}.{count}"), shape)? })
}

/// What a decoder must fit.
#[derive(Clone, Copy)]
struct DecoderSizes {
    columns: Size,
    embedding: usize,
    levels: usize,
}

fn decoder(
    source: &mut Source<'_>,
    name: &str,
    sizes: DecoderSizes,
) -> Result<DecoderWeights, CheckpointError> {
    let model = format!("{name}.level_blocks.0.model");
    let shape = ConvolutionShape::new(Any("width"), Is(sizes.embedding), KERNEL);
    let input = convolution(source, &format!("{model}.0"), shape)?;
    let mut width = input.weight.dim(0);
    let mut levels = Vec::with_capacity(sizes.levels);
    for level in 1..=sizes.levels {
        let stack = stack(source, &format!("{model}.{level}.0"), width, Dilations::Descending)?;
        let transposed = transposed(source, &format!("{model}.{level}.1"), width)?;
        width = transposed.weight.dim(1);
        levels.push(DecoderLevel { stack, transposed });
    }
    let shape = ConvolutionShape::new(sizes.columns, Is(width), KERNEL);
    Ok(DecoderWeights {
        input,
        levels,
        output: convolution(source, &format!("{name}.out"), shape)?,
    })
}

#[derive(Clone, Copy)]
pub(super) enum Dilations {
    Ascending,
    Descending,
}

impl Dilations {
    /// Returns the dilation of the block at a place of a stack.
    pub(super) fn of(self, place: usize, depth: usize) -> usize {
        let exponent = match self {
            Self::Ascending => place,
            Self::Descending => depth - 1 - place,
        };
        // The depth is bounded by the tensors of the file; saturating keeps odd files harmless.
        DILATION_GROWTH.saturating_pow(u32::try_from(exponent).unwrap_or(u32::MAX))
    }
}

fn stack(
    source: &mut Source<'_>,
    name: &str,
    width: usize,
    dilations: Dilations,
) -> Result<Vec<ResidualBlock>, CheckpointError> {
    let depth = source.count(|block| format!("{name}.model.{block}.model.1.weight")).max(1);
    let mut blocks = Vec::with_capacity(depth);
    for place in 0..depth {
        let block = format!("{name}.model.{place}.model");
        let shape = ConvolutionShape::new(Any("width"), Is(width), KERNEL);
        let dilated = convolution(source, &format!("{block}.1"), shape)?;
        let shape = ConvolutionShape::new(Is(width), Is(dilated.weight.dim(0)), 1);
        blocks.push(ResidualBlock {
            pointwise: convolution(source, &format!("{block}.3"), shape)?,
            dilation: dilations.of(place, depth),
            dilated,
        });
    }
    Ok(blocks)
}

#[derive(Clone, Copy)]
pub(super) struct ConvolutionShape {
    outputs: Size,
    inputs: Size,
    kernel: usize,
}

impl ConvolutionShape {
    pub(super) fn new(outputs: Size, inputs: Size, kernel: usize) -> Self {
        Self { outputs, inputs, kernel }
    }
}

pub(super) fn convolution(
    source: &mut Source<'_>,
    name: &str,
    shape: ConvolutionShape,
) -> Result<Convolution, CheckpointError> {
    let weight =
        source.take(&format!("{name}.weight"), &[shape.outputs, shape.inputs, Is(shape.kernel)])?;
    let bias = source.take(&format!("{name}.bias"), &[Is(weight.dim(0))])?;
    Ok(Convolution { weight, bias })
}

pub(super) fn transposed(
    source: &mut Source<'_>,
    name: &str,
    inputs: usize,
) -> Result<Convolution, CheckpointError> {
    let shape = [Is(inputs), Any("width"), Is(STRIDED_KERNEL)];
    let weight = source.take(&format!("{name}.weight"), &shape)?;
    let bias = source.take(&format!("{name}.bias"), &[Is(weight.dim(1))])?;
    Ok(Convolution { weight, bias })
}
