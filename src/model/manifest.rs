//! `manifest.json`: the single source of truth for shapes, rates, vocabulary, window and skeleton.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{features::Profile, motion::Skeleton};

/// The manifest layout this version reads and writes.
pub const FORMAT_VERSION: u32 = 1;

/// What a model directory says about itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Layout version, see [`FORMAT_VERSION`].
    pub format_version: u32,
    /// Name of the model, reported with every dance.
    pub name: String,
    /// Licence of the weights.
    pub licence: String,
    /// Which music features condition the model.
    pub features: FeatureSpec,
    /// Frames per second of the decoded motion.
    pub fps: u32,
    /// Motion frames that one pose code stands for (ARCHITECTURE: down-sampling 8).
    pub frames_per_code: usize,
    /// Number of pose codes per half body.
    pub vocabulary: Vocabulary,
    /// Sizes of the motion GPT.
    pub gpt: GptSpec,
    /// Sizes of the decoder.
    pub decoder: DecoderSpec,
    /// Rest skeleton, metres, y up.
    pub skeleton: Skeleton,
    /// Joints that the upper half decodes, ascending.
    pub upper_joints: Vec<usize>,
    /// Joints that the lower half decodes, ascending.
    pub lower_joints: Vec<usize>,
    /// Pairs (upper, lower) to draw a start from; empty: any pair of the vocabulary.
    pub start_codes: Vec<[u32; 2]>,
    /// Sampling defaults.
    pub sampling: SamplingDefaults,
    /// How weights are stored: they are computed with in float32 either way.
    pub weights: WeightStorage,
    /// Every other file of the directory.
    pub files: BTreeMap<String, FileEntry>,
    /// How it was trained (data, steps, commit, metrics), as free text and figures.
    #[serde(default)]
    pub training: BTreeMap<String, serde_json::Value>,
}

/// Which music features condition the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureSpec {
    /// Version of the feature chain.
    pub profile: Profile,
    /// Sample rate in Hz that the features are computed at.
    pub sample_rate: u32,
    /// Samples between feature rows.
    pub hop: usize,
    /// Values per row.
    pub columns: usize,
}

/// Number of pose codes per half body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vocabulary {
    /// Codes of the upper half.
    pub upper: usize,
    /// Codes of the lower half.
    pub lower: usize,
}

/// Sizes of the motion GPT.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GptSpec {
    /// Rows of each stream's position table.
    pub block: usize,
    /// Longest history in codes while sampling (ARCHITECTURE section 3: block - 1).
    pub context: usize,
    /// Embedding width.
    pub channels: usize,
    /// Transformer blocks, base and head together.
    pub layers: usize,
    /// Attention heads.
    pub heads: usize,
}

/// Sizes of the decoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecoderSpec {
    /// Channels of the convolutions.
    pub width: usize,
    /// Codes on either side that can influence a decoded code's frames: the overlap of chunks.
    pub receptive_codes: usize,
}

/// How the window of past codes moves (ARCHITECTURE section 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WindowKind {
    /// Shrinks to `hop` codes and grows again, so that the key/value cache is exact.
    Hop,
    /// Always the longest history, recomputed at every step, as the reference samples.
    Sliding,
}

/// Sampling defaults.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplingDefaults {
    /// 0 takes the most likely code, as in the paper.
    pub temperature: f32,
    /// Codes to draw from; absent: all.
    #[serde(default)]
    pub top_k: Option<usize>,
    /// How the window moves.
    pub window: WindowKind,
    /// Codes kept when a hop window shrinks.
    pub hop: usize,
}

/// How weights are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WeightStorage {
    /// 32-bit floats.
    F32,
    /// 16-bit floats, widened when loaded.
    F16,
}

/// Size and hash of one file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileEntry {
    /// Length in bytes.
    pub bytes: u64,
    /// SHA-256, lower-case hexadecimal.
    pub sha256: String,
}
