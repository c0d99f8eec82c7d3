//! The manifest: sizes from the weights, everything else from the description.

use std::collections::BTreeMap;

use bailando::{
    features::{HOP, Profile, Rate},
    model::{
        CountSource, DecoderSpec, FORMAT_VERSION, FeatureSpec, GptSpec, Manifest, MannerSpec,
        SamplingDefaults, StyleClassifier, StyleCodes, SuppressedCodes, Vocabulary, WeightStorage,
        WindowKind,
    },
    motion::MotionFrame,
};

use super::{ExportError, skeleton};
use crate::{
    onnx::receptive_codes,
    weights::{GptWeights, HALF_JOINTS, VqVaeWeights},
};

/// Frames per second of all motion that the models know.
const FPS: u32 = 60;

/// Codes that a window keeps when it moves, as the golden vectors and the model cards have it.
pub const PUBLISHED_HOP: usize = 15;

/// The manifest's entries that do not follow from the weights.
#[derive(Clone, Debug)]
pub struct Description {
    /// Name of the model.
    pub name: String,
    /// Licence of the weights.
    pub licence: String,
    /// Feature chain that the model was trained with.
    pub profile: Profile,
    /// Periods in counts that the model is conditioned on, after the features.
    pub count_periods: Vec<u32>,
    /// The tracker whose counts it is served with.
    pub counts: CountSource,
    /// Names of the styles that it is told after the music.
    pub styles: Vec<String>,
    /// Whether it is told energies after these.
    pub energy: bool,
    /// Finds the style of a song; none where that is left to the caller.
    pub classifier: Option<StyleClassifier>,
    /// Pairs (upper, lower) to draw a start from; empty: any pair.
    pub start_codes: Vec<[u32; 2]>,
    /// Those of dances in a style.
    pub style_start_codes: BTreeMap<String, Vec<[u32; 2]>>,
    /// Codes that dances in a style may draw.
    pub style_codes: BTreeMap<String, StyleCodes>,
    /// Codes that are never drawn.
    pub suppressed_codes: SuppressedCodes,
    /// Default temperature; 0 takes the most likely code.
    pub temperature: f32,
    /// Default scale of classifier-free guidance by the music; 1 is none.
    pub guidance: f32,
    /// Default number of candidates for a segment; 1 takes the first.
    pub candidates: usize,
    /// Whether segments that stand still are regenerated.
    pub redo: bool,
    /// Codes that a window keeps when it moves ([`PUBLISHED_HOP`]); at most the context.
    pub hop: usize,
    /// Frame of the motion that the weights were trained on.
    pub motion_frame: MotionFrame,
    /// Height in metres at which the root starts.
    pub root_height: f32,
    /// How weights are stored.
    pub weights: WeightStorage,
    /// How the model was trained.
    pub training: BTreeMap<String, serde_json::Value>,
}

/// The manifest without its files.
pub(super) fn manifest(
    gpt: &GptWeights,
    vqvae: &VqVaeWeights,
    description: &Description,
) -> Result<Manifest, ExportError> {
    let context = gpt.block().saturating_sub(1);
    let (upper_joints, lower_joints) = HALF_JOINTS;
    let Description { styles, energy, .. } = description;
    let manners = MannerSpec { styles: styles.len(), energy: *energy };
    Ok(Manifest {
        format_version: FORMAT_VERSION,
        name: description.name.clone(),
        licence: description.licence.clone(),
        features: FeatureSpec {
            profile: description.profile,
            sample_rate: Rate::Conditioning.hz(),
            hop: HOP,
            // Fewer columns than manners are refused with what the manifest says of features.
            columns: gpt.columns().saturating_sub(manners.columns()),
            count_periods: description.count_periods.clone(),
            counts: description.counts,
            counts_late_s: 0.0,
        },
        styles: styles.clone(),
        energy: *energy,
        fps: FPS,
        frames_per_code: vqvae.frames_per_code(),
        motion_frame: checked_frame(vqvae, description.motion_frame)?,
        vocabulary: vocabulary(gpt, vqvae)?,
        gpt: GptSpec {
            block: gpt.block(),
            context,
            channels: gpt.channels(),
            layers: gpt.blocks.len(),
            heads: gpt.heads,
        },
        decoder: DecoderSpec { width: vqvae.width(), receptive_codes: receptive_codes(vqvae) },
        skeleton: skeleton(description.root_height),
        upper_joints: upper_joints.to_vec(),
        lower_joints: lower_joints.to_vec(),
        start_codes: description.start_codes.clone(),
        style_start_codes: description.style_start_codes.clone(),
        style_codes: description.style_codes.clone(),
        suppressed_codes: description.suppressed_codes.clone(),
        sampling: SamplingDefaults {
            temperature: description.temperature,
            top_k: None,
            guidance: description.guidance,
            candidates: description.candidates,
            redo: description.redo,
            window: WindowKind::Hop,
            hop: description.hop.min(context),
        },
        weights: description.weights,
        files: BTreeMap::new(),
        training: description.training.clone(),
    })
}

/// The root moves and, in the dancer's frame, turns: its decoder has the columns of one joint.
fn checked_frame(vqvae: &VqVaeWeights, frame: MotionFrame) -> Result<MotionFrame, ExportError> {
    let (expected, found) = (frame.columns(1), vqvae.root_columns());
    if found == expected {
        return Ok(frame);
    }
    Err(ExportError::Frame { frame, expected, found })
}

fn vocabulary(gpt: &GptWeights, vqvae: &VqVaeWeights) -> Result<Vocabulary, ExportError> {
    let same = |half, embedding: &crate::HostTensor, codebook: &crate::HostTensor| {
        if embedding.dim(0) == codebook.dim(0) {
            return Ok(codebook.dim(0));
        }
        Err(ExportError::Vocabulary { half, gpt: embedding.dim(0), codebook: codebook.dim(0) })
    };
    Ok(Vocabulary {
        upper: same("upper", &gpt.upper_embedding, &vqvae.upper.codebook)?,
        lower: same("lower", &gpt.lower_embedding, &vqvae.lower.codebook)?,
    })
}
