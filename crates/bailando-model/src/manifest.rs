//! `manifest.json`: the single source of truth for shapes, rates, vocabulary, window and skeleton.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{MannerSpec, StyleCodes, SuppressedCodes, Vocabulary, manner::check_styles};
use bailando_features::{COLUMNS, HOP, Profile, Rate};
use bailando_motion::{MotionFrame, Skeleton};

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
    /// Styles that the model can be asked for; absent: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub styles: Vec<String>,
    /// Whether it can be asked for more or less energy; absent: no.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub energy: bool,
    /// Frames per second of the decoded motion.
    pub fps: u32,
    /// Motion frames that one pose code stands for (ARCHITECTURE: down-sampling 8).
    pub frames_per_code: usize,
    /// Frame of the motion that is decoded and encoded; absent: the world's, as published.
    ///
    /// In the dancer's frame `decoder.onnx` gives one more column, the turn to the next frame, and
    /// `encoder.onnx` takes joints that are turned to face +z already, without that column.
    #[serde(default, skip_serializing_if = "MotionFrame::is_world")]
    pub motion_frame: MotionFrame,
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
    /// Those to draw the start of a dance in a style from, by its name; absent, as for a dance in
    /// none: all.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub style_start_codes: BTreeMap<String, Vec<[u32; 2]>>,
    /// Codes that a dance in a style may draw, by its name; absent, as for a dance in none: all.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub style_codes: BTreeMap<String, StyleCodes>,
    /// Codes that are never drawn; absent: none.
    #[serde(default, skip_serializing_if = "SuppressedCodes::is_empty")]
    pub suppressed_codes: SuppressedCodes,
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

/// Most seconds by which counts are moved: less than the shortest half count.
const MAX_LATE_S: f64 = 0.1;

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
    /// Periods in counts whose sine and cosine follow the 438 columns
    /// ([`with_counts`](bailando_features::with_counts)); none: as published.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub count_periods: Vec<u32>,
    /// The tracker whose counts these are; absent: that of the first models, `librosa`.
    #[serde(default, skip_serializing_if = "CountSource::is_librosa")]
    pub counts: CountSource,
    /// Seconds by which the counts that the model was trained with came later than those of
    /// `counts` do: these are moved by as much; absent: 0.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub counts_late_s: f64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
fn is_zero(number: &f64) -> bool {
    *number == 0.0
}

/// A tracker of counts. A model follows those that it was trained with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CountSource {
    /// librosa's beats (column 53 at 30,720 Hz), bars by changes of harmony: about 30 ms late.
    #[default]
    Librosa,
    /// The beats of [`BeatNetwork`](super::BeatNetwork), bars by its first beats and harmony.
    Beatnet,
}

impl CountSource {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
    fn is_librosa(&self) -> bool {
        *self == Self::Librosa
    }
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
    /// How strongly the music's time is followed; absent: 1, as the model predicts.
    #[serde(default = "unguided", skip_serializing_if = "is_unguided")]
    pub guidance: f32,
    /// Candidates for every segment; the best is kept: its beats lie nearest to the music's, and
    /// few of its frames stand still. Absent: 1.
    #[serde(default = "one_candidate", skip_serializing_if = "is_one_candidate")]
    pub candidates: usize,
    /// Whether a segment in which the dancer stands still is generated again, where it may come out
    /// otherwise. Absent: only where there are several candidates.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub redo: bool,
    /// How the window moves.
    pub window: WindowKind,
    /// Codes kept when a hop window shrinks.
    pub hop: usize,
}

fn unguided() -> f32 {
    1.0
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
fn is_unguided(guidance: &f32) -> bool {
    *guidance == unguided()
}

fn one_candidate() -> usize {
    1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
fn is_one_candidate(candidates: &usize) -> bool {
    *candidates == one_candidate()
}

/// How weights are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WeightStorage {
    /// 32-bit floats.
    F32,
    /// 16-bit floats, widened when loaded.
    F16,
    /// The GPT's matrices as 8-bit integers, all else as 16-bit floats.
    Int8,
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

/// Most count periods that a model may be conditioned on.
pub const MAX_COUNT_PERIODS: usize = 16;
/// Highest temperature: beyond it every code is as likely as the next.
pub const MAX_TEMPERATURE: f32 = 10.0;
/// Most candidates for a segment: the cost of a generation grows with them.
pub const MAX_CANDIDATES: usize = 16;
/// Highest guidance: beyond it little but noise is exaggerated.
pub const MAX_GUIDANCE: f32 = 10.0;
// A directory from a stranger must not make us allocate what it declares; the published sizes are
// 12, 29, 768, 512 and 25.
const MAX_LAYERS: usize = 256;
const MAX_BLOCK: usize = 4096;
const MAX_CHANNELS: usize = 16_384;
const MAX_CODES: usize = 65_536;
const MAX_RECEPTIVE_CODES: usize = 4096;
const MAX_JOINTS: usize = 1024;
/// Most bytes of keys and values of one sequence; the published model has 6 MiB.
const MAX_MEMORY_BYTES: u64 = 1 << 30;
/// Files that every model directory has besides its manifest.
const REQUIRED_FILES: [&str; 3] = ["gpt.onnx", "decoder.onnx", "encoder.onnx"];

impl Manifest {
    /// Columns of motion as it is encoded and served: three per joint.
    #[must_use]
    pub fn motion_columns(&self) -> usize {
        3 * self.skeleton.joints.len()
    }

    /// What the model can be asked for beside the music.
    #[must_use]
    pub fn manners(&self) -> MannerSpec {
        MannerSpec { styles: self.styles.len(), energy: self.energy }
    }

    /// Columns of `gpt.onnx`'s input `music`: those of the features, then those of the manner.
    #[must_use]
    pub fn conditioning_columns(&self) -> usize {
        self.features.columns + self.manners().columns()
    }

    /// Columns of motion as `decoder.onnx` gives it.
    #[must_use]
    pub fn decoded_columns(&self) -> usize {
        self.motion_frame.columns(self.skeleton.joints.len())
    }

    /// Pose codes per second.
    #[must_use]
    pub fn codes_per_second(&self) -> f64 {
        f64::from(self.fps) / self.frames_per_code as f64
    }

    /// Checks that the manifest does not contradict itself or this version.
    ///
    /// # Errors
    /// One line that says what does not fit.
    pub fn validate(&self) -> Result<(), String> {
        if self.format_version != FORMAT_VERSION {
            return Err(format!(
                "format_version is {}, this version reads {FORMAT_VERSION}",
                self.format_version
            ));
        }
        self.validate_rates()?;
        check_styles(&self.styles)?;
        self.validate_sizes()?;
        self.validate_sampling()?;
        self.skeleton.validate().map_err(|e| e.to_string())?;
        self.validate_joints()?;
        self.validate_files()
    }

    fn validate_rates(&self) -> Result<(), String> {
        let features = &self.features;
        let rate = Rate::Conditioning;
        let periods = features.count_periods.len();
        if periods > MAX_COUNT_PERIODS || features.count_periods.contains(&0) {
            return Err(format!(
                "features have {periods} count_periods, expected at most {MAX_COUNT_PERIODS}, \
                 none of them 0"
            ));
        }
        // Counts are found with the current chain alone.
        if periods > 0 && features.profile != Profile::Librosa011 {
            return Err("features have count_periods, which need the profile librosa-0.11".into());
        }
        let late = features.counts_late_s;
        if !(-MAX_LATE_S..=MAX_LATE_S).contains(&late) {
            return Err(format!(
                "features have counts_late_s of {late}, expected at most {MAX_LATE_S} either way"
            ));
        }
        let columns = COLUMNS + 2 * periods;
        if features.sample_rate != rate.hz() || features.hop != HOP || features.columns != columns {
            return Err(format!(
                "features are {} columns every {} samples at {} Hz, this version computes \
                 {columns} every {HOP} at {}",
                features.columns,
                features.hop,
                features.sample_rate,
                rate.hz()
            ));
        }
        let one_row_per_code = self.frames_per_code > 0
            && (self.codes_per_second() - rate.rows_per_second()).abs() < 1e-9;
        if self.fps != 60 || !one_row_per_code {
            return Err(format!(
                "{} fps with {} frames per code: expected 60 and 8, one code per music row",
                self.fps, self.frames_per_code
            ));
        }
        Ok(())
    }

    fn validate_sizes(&self) -> Result<(), String> {
        let gpt = self.gpt;
        if gpt.heads == 0 || gpt.channels == 0 || !gpt.channels.is_multiple_of(gpt.heads) {
            return Err(format!(
                "{} channels cannot be shared by {} heads",
                gpt.channels, gpt.heads
            ));
        }
        if gpt.context == 0 || gpt.context >= gpt.block {
            return Err(format!(
                "gpt has a context of {} in a block of {}: at least 1 and below the block",
                gpt.context, gpt.block
            ));
        }
        let sizes = [
            ("layers", gpt.layers, MAX_LAYERS),
            ("block", gpt.block, MAX_BLOCK),
            ("channels", gpt.channels, MAX_CHANNELS),
            ("decoder width", self.decoder.width, MAX_CHANNELS),
            ("upper vocabulary", self.vocabulary.upper, MAX_CODES),
            ("lower vocabulary", self.vocabulary.lower, MAX_CODES),
            ("number of joints", self.skeleton.joints.len(), MAX_JOINTS),
        ];
        for (name, size, most) in sizes {
            if !(1..=most).contains(&size) {
                return Err(format!("{name} is {size}, expected 1 to {most}"));
            }
        }
        let memory = self.memory_bytes();
        if memory > MAX_MEMORY_BYTES {
            return Err(format!(
                "gpt has {memory} bytes of keys and values a sequence, expected at most \
                 {MAX_MEMORY_BYTES}"
            ));
        }
        let receptive = self.decoder.receptive_codes;
        if receptive > MAX_RECEPTIVE_CODES {
            return Err(format!(
                "receptive_codes is {receptive}, expected at most {MAX_RECEPTIVE_CODES}"
            ));
        }
        Ok(())
    }

    /// Pairs to draw the start of a dance in a style from, or in none; empty: any pair.
    #[must_use]
    pub fn starts_in(&self, style: Option<&str>) -> &[[u32; 2]] {
        let own = style.and_then(|style| self.style_start_codes.get(style));
        own.filter(|own| !own.is_empty()).unwrap_or(&self.start_codes)
    }

    /// Codes that a dance in a style may draw, or in none, upper and lower, ascending.
    #[must_use]
    pub fn drawable_in(&self, style: Option<&str>) -> [Vec<u32>; 2] {
        let mut codes = self.suppressed_codes.others(self.vocabulary);
        if let Some(own) = style.and_then(|style| self.style_codes.get(style)) {
            own.narrow(&mut codes);
        }
        codes
    }

    /// Bytes of a sequence's keys and values: three streams, in float32.
    fn memory_bytes(&self) -> u64 {
        let GptSpec { block, channels, layers, .. } = self.gpt;
        let numbers = [2, 3, layers, block, channels].map(|size| size as u64);
        4 * numbers.iter().product::<u64>()
    }

    fn validate_sampling(&self) -> Result<(), String> {
        let Vocabulary { upper, lower } = self.vocabulary;
        let fits = |&[u, l]: &[u32; 2]| (u as usize) < upper && (l as usize) < lower;
        if let Some([u, l]) = self.start_codes.iter().find(|pair| !fits(pair)) {
            return Err(format!("start codes {u}, {l} lie outside the vocabulary"));
        }
        for (style, pairs) in &self.style_start_codes {
            if !self.styles.contains(style) {
                return Err(format!("style_start_codes has {style:?}, which is none of styles"));
            }
            if let Some([u, l]) = pairs.iter().find(|pair| !self.start_codes.contains(pair)) {
                return Err(format!("start codes {u}, {l} of {style} are none of start_codes"));
            }
        }
        for (style, codes) in &self.style_codes {
            if !self.styles.contains(style) {
                return Err(format!("style_codes has {style:?}, which is none of styles"));
            }
            if ![&codes.upper, &codes.lower].iter().all(|codes| codes.is_sorted_by(|a, b| a < b)) {
                return Err(format!("style_codes of {style} are not ascending"));
            }
            if self.drawable_in(Some(style)).iter().any(Vec::is_empty) {
                return Err(format!("style_codes leave {style} nothing to draw"));
            }
        }
        self.suppressed_codes.validate(self.vocabulary, &self.start_codes)?;
        let SamplingDefaults { temperature, top_k, guidance, candidates, hop, .. } = self.sampling;
        if !(0.0..=MAX_TEMPERATURE).contains(&temperature) {
            return Err(format!(
                "sampling temperature is {temperature}, expected 0 to {MAX_TEMPERATURE}"
            ));
        }
        if !(0.0..=MAX_GUIDANCE).contains(&guidance) {
            return Err(format!("sampling guidance is {guidance}, expected 0 to {MAX_GUIDANCE}"));
        }
        if !(1..=MAX_CANDIDATES).contains(&candidates) {
            return Err(format!(
                "sampling candidates is {candidates}, expected 1 to {MAX_CANDIDATES}"
            ));
        }
        if top_k == Some(0) {
            return Err("sampling top_k is 0".into());
        }
        if hop == 0 || hop > self.gpt.context {
            return Err(format!("sampling hop is {hop}, the context {}", self.gpt.context));
        }
        Ok(())
    }

    fn validate_joints(&self) -> Result<(), String> {
        let mut joints: Vec<_> = self.upper_joints.iter().chain(&self.lower_joints).collect();
        joints.sort_unstable();
        if joints.into_iter().ne(&(0..self.skeleton.joints.len()).collect::<Vec<_>>()) {
            return Err("upper_joints and lower_joints must hold each joint once".into());
        }
        Ok(())
    }

    fn validate_files(&self) -> Result<(), String> {
        for name in REQUIRED_FILES {
            if !self.files.contains_key(name) {
                return Err(format!("files does not list {name}"));
            }
        }
        // A directory from a stranger must not make us read outside of it.
        let plain = |name: &str| {
            !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\', ':', '\0'])
        };
        match self.files.keys().find(|name| !plain(name)) {
            Some(name) => Err(format!("files lists {name:?}, which is not a plain file name")),
            None => Ok(()),
        }
    }
}
