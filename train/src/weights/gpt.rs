//! The motion GPT (ARCHITECTURE section 3): state network, policy, and critic.

use super::{
    WeightError,
    source::{
        Size::{Any, Is},
        Source,
    },
};
use crate::{HostTensor, checkpoint::CheckpointError, checkpoint::TorchCheckpoint};

/// Streams that the position table covers: music, upper and lower codes.
pub(super) const STREAMS: usize = 3;

/// An affine map: `weight` is `[out, in]`, `bias` is `[out]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// Matrix, `[out, in]`.
    pub weight: HostTensor,
    /// Offset, `[out]`.
    pub bias: HostTensor,
}

/// Scale and offset of a layer normalisation, each `[channels]`.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerNorm {
    /// Scale.
    pub weight: HostTensor,
    /// Offset.
    pub bias: HostTensor,
}

/// A pre-norm transformer block.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Before the attention.
    pub attention_norm: LayerNorm,
    /// Queries, `[channels, channels]`.
    pub query: Linear,
    /// Keys, `[channels, channels]`.
    pub key: Linear,
    /// Values, `[channels, channels]`.
    pub value: Linear,
    /// Output of the attention, `[channels, channels]`.
    pub projection: Linear,
    /// Before the perceptron.
    pub mlp_norm: LayerNorm,
    /// First map of the perceptron, `[hidden, channels]`.
    pub mlp_in: Linear,
    /// Second map of the perceptron, `[channels, hidden]`.
    pub mlp_out: Linear,
}

/// Weights of the motion GPT.
#[derive(Clone, Debug, PartialEq)]
pub struct GptWeights {
    /// Music rows to channels, `[channels, columns]`.
    pub music: Linear,
    /// Upper codes, `[vocabulary, channels]`.
    pub upper_embedding: HostTensor,
    /// Lower codes, `[vocabulary, channels]`.
    pub lower_embedding: HostTensor,
    /// Learned positions of music, upper and lower in turn, `[3 * block, channels]`.
    pub positions: HostTensor,
    /// Blocks of the state network, then those of the policy.
    pub blocks: Vec<Block>,
    /// After the last block.
    pub final_norm: LayerNorm,
    /// Channels to upper logits, `[vocabulary, channels]`.
    pub upper_head: HostTensor,
    /// Channels to lower logits, `[vocabulary, channels]`.
    pub lower_head: HostTensor,
    /// Attention heads.
    pub heads: usize,
}

/// Weights of the critic, which stands on the state network beside the policy.
#[derive(Clone, Debug, PartialEq)]
pub struct CriticWeights {
    /// Its blocks.
    pub blocks: Vec<Block>,
    /// After the last block.
    pub final_norm: LayerNorm,
    /// Channels to the upper half's value, `[1, channels]`.
    pub upper_value: HostTensor,
    /// Channels to the lower half's value, `[1, channels]`.
    pub lower_value: HostTensor,
    /// Attention heads.
    pub heads: usize,
}

impl CriticWeights {
    /// Takes the critic out of an official checkpoint with `heads` attention heads.
    ///
    /// # Errors
    /// [`WeightError`] names the first tensor that is missing or does not fit the others.
    pub fn from_checkpoint(
        checkpoint: &mut TorchCheckpoint,
        heads: usize,
    ) -> Result<Self, WeightError> {
        let mut source = Source::new(checkpoint);
        let upper_value = source.take("critic_net.head_up.weight", &[Is(1), Any("channels")])?;
        let channels = upper_value.dim(1);
        let lower_value = source.take("critic_net.head_down.weight", &[Is(1), Is(channels)])?;
        check_heads(&source, channels, heads)?;
        Ok(Self {
            blocks: blocks(&mut source, "critic_net", channels)?,
            final_norm: layer_norm(&mut source, "critic_net.ln_f", channels)?,
            upper_value,
            lower_value,
            heads,
        })
    }
}

impl GptWeights {
    /// Takes the weights out of an official checkpoint with `heads` attention heads.
    ///
    /// # Errors
    /// [`WeightError`] names the first tensor that is missing or does not fit the others.
    pub fn from_checkpoint(
        checkpoint: &mut TorchCheckpoint,
        heads: usize,
    ) -> Result<Self, WeightError> {
        let mut source = Source::new(checkpoint);
        let upper_embedding =
            source.take("gpt_base.tok_emb_up.weight", &[Any("vocabulary"), Any("channels")])?;
        let channels = upper_embedding.dim(1);
        check_heads(&source, channels, heads)?;
        let lower_embedding =
            source.take("gpt_base.tok_emb_down.weight", &[Any("vocabulary"), Is(channels)])?;
        let positions = positions(&mut source, channels)?;
        let mut blocks = blocks(&mut source, "gpt_base", channels)?;
        blocks.extend(self::blocks(&mut source, "gpt_head", channels)?);
        Ok(Self {
            music: linear(&mut source, "gpt_base.cond_emb", Is(channels), Any("columns"))?,
            final_norm: layer_norm(&mut source, "gpt_head.ln_f", channels)?,
            upper_head: source
                .take("gpt_head.head_up.weight", &[Is(upper_embedding.dim(0)), Is(channels)])?,
            lower_head: source
                .take("gpt_head.head_down.weight", &[Is(lower_embedding.dim(0)), Is(channels)])?,
            upper_embedding,
            lower_embedding,
            positions,
            blocks,
            heads,
        })
    }

    /// Embedding width.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.positions.dim(1)
    }

    /// Rows of each stream's part of the position table.
    #[must_use]
    pub fn block(&self) -> usize {
        self.positions.dim(0) / STREAMS
    }

    /// Values per music row.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.music.weight.dim(1)
    }

    /// Channels per attention head.
    #[must_use]
    pub fn head_size(&self) -> usize {
        self.channels() / self.heads.max(1)
    }
}

pub(super) fn check_heads(
    source: &Source<'_>,
    channels: usize,
    heads: usize,
) -> Result<(), WeightError> {
    if heads > 0 && channels.is_multiple_of(heads) {
        return Ok(());
    }
    Err(WeightError::Heads { path: source.path().to_owned(), channels, heads })
}

/// The position table without its leading dimension of 1.
fn positions(source: &mut Source<'_>, channels: usize) -> Result<HostTensor, CheckpointError> {
    const NAME: &str = "gpt_base.pos_emb";
    let table = source.take(NAME, &[Is(1), Any("3 x block"), Is(channels)])?;
    let rows = table.dim(1);
    // Sampling needs a history of at least one code beside the one that is predicted.
    if !rows.is_multiple_of(STREAMS) || rows < 2 * STREAMS {
        return Err(source.mismatch(
            NAME,
            "[1, 3 x block, channels] with a block of 2 or more",
            &table,
        ));
    }
    let flat = HostTensor::new(vec![rows, channels], table.data().to_vec());
    flat.map_err(|_| source.mismatch(NAME, "[1, 3 x block, channels]", &table))
}

fn blocks(
    source: &mut Source<'_>,
    part: &str,
    channels: usize,
) -> Result<Vec<Block>, CheckpointError> {
    let count = source.count(|index| format!("{part}.blocks.{index}.ln1.weight"));
    // An empty part would be silently wrong: ask for its first block and report that it is missing.
    (0..count.max(1))
        .map(|index| block(source, &format!("{part}.blocks.{index}"), channels))
        .collect()
}

fn block(source: &mut Source<'_>, name: &str, channels: usize) -> Result<Block, CheckpointError> {
    let mut square =
        |part: &str| linear(source, &format!("{name}.attn.{part}"), Is(channels), Is(channels));
    let (query, key, value) = (square("query")?, square("key")?, square("value")?);
    let projection = square("proj")?;
    let mlp_in = linear(source, &format!("{name}.mlp.0"), Any("hidden"), Is(channels))?;
    let hidden = mlp_in.weight.dim(0);
    Ok(Block {
        attention_norm: layer_norm(source, &format!("{name}.ln1"), channels)?,
        query,
        key,
        value,
        projection,
        mlp_norm: layer_norm(source, &format!("{name}.ln2"), channels)?,
        mlp_in,
        mlp_out: linear(source, &format!("{name}.mlp.2"), Is(channels), Is(hidden))?,
    })
}

fn linear(
    source: &mut Source<'_>,
    name: &str,
    outputs: super::source::Size,
    inputs: super::source::Size,
) -> Result<Linear, CheckpointError> {
    let weight = source.take(&format!("{name}.weight"), &[outputs, inputs])?;
    let bias = source.take(&format!("{name}.bias"), &[Is(weight.dim(0))])?;
    Ok(Linear { weight, bias })
}

fn layer_norm(
    source: &mut Source<'_>,
    name: &str,
    channels: usize,
) -> Result<LayerNorm, CheckpointError> {
    Ok(LayerNorm {
        weight: source.take(&format!("{name}.weight"), &[Is(channels)])?,
        bias: source.take(&format!("{name}.bias"), &[Is(channels)])?,
    })
}
