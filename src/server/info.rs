//! The description of the service.

use serde::Serialize;
use utoipa::ToSchema;

use super::{
    config::Limits,
    options::{self, OptionInfo},
};
use crate::{
    audio::FORMATS,
    formats::OutputFormat,
    model::{Manifest, WindowKind},
    motion::FRAME_RATES,
};

/// Answer of `GET /info`.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(crate) struct Info {
    /// Version of the server.
    #[schema(example = "0.1.0")]
    version: &'static str,
    model: ModelInfo,
    /// Frame rates of a result.
    frame_rates: [u32; 4],
    /// All options of a generation.
    options: Vec<OptionInfo>,
    /// Formats of a result, the default first.
    formats: Vec<FormatInfo>,
    /// Audio that is accepted.
    #[schema(example = json!(["wav", "flac"]))]
    audio: Vec<&'static str>,
    limits: Bounds,
}

/// Every limit, and the memory that follows from them.
#[derive(Clone, Debug, Serialize, ToSchema)]
struct Bounds {
    #[serde(flatten)]
    limits: Limits,
    /// Most memory of one request that is being processed. The server as a whole stays below its
    /// idle memory and this much for each of `max_concurrent_requests`, beside waiting uploads and
    /// responses.
    memory_per_request_bytes: u64,
}

/// The loaded model.
#[derive(Clone, Debug, Serialize, ToSchema)]
struct ModelInfo {
    /// Name, from the manifest.
    name: String,
    /// Licence of the weights.
    licence: String,
    /// SHA-256 of `manifest.json`, which holds the hash of every other file.
    manifest_sha256: String,
    /// Frames per second of the model itself.
    fps: u32,
    /// Pose codes per second of music.
    codes_per_second: f64,
    vocabulary: VocabularyInfo,
    /// Styles that the option `style` accepts beside `auto` and `mixed`; none where the model has
    /// none.
    #[schema(example = json!(["house", "krump"]))]
    styles: Vec<String>,
    /// Whether the option `energy` is accepted.
    energy: bool,
    /// Longest history in pose codes.
    context: usize,
    sampling: SamplingInfo,
    /// Version of the music features.
    features: String,
    skeleton: SkeletonInfo,
}

/// Number of pose codes per half body.
#[derive(Clone, Debug, Serialize, ToSchema)]
struct VocabularyInfo {
    upper: usize,
    lower: usize,
}

/// The model's defaults for options of the same names.
#[derive(Clone, Debug, Serialize, ToSchema)]
struct SamplingInfo {
    temperature: f32,
    top_k: Option<usize>,
    guidance: f32,
    candidates: usize,
    redo: bool,
    #[schema(example = "hop")]
    window: &'static str,
    hop: usize,
}

/// Rest skeleton, y up, right-handed, facing +z.
#[derive(Clone, Debug, Serialize, ToSchema)]
struct SkeletonInfo {
    /// Joint names, SMPL order.
    joints: Vec<String>,
    /// Parent of each joint; -1 for the root.
    parents: Vec<i32>,
    /// Offset of each joint from its parent in metres.
    offsets: Vec<[f32; 3]>,
}

/// A format of a result.
#[derive(Clone, Debug, Serialize, ToSchema)]
struct FormatInfo {
    /// Value of the option `format`.
    #[schema(example = "json")]
    name: &'static str,
    #[schema(example = "application/json")]
    content_type: &'static str,
}

impl Info {
    pub(crate) fn new(manifest: &Manifest, sha256: &str, limits: &Limits) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            model: ModelInfo::new(manifest, sha256),
            frame_rates: FRAME_RATES,
            options: options::describe(&manifest.styles),
            formats: OutputFormat::ALL
                .map(|format| FormatInfo {
                    name: format.name(),
                    content_type: format.content_type(),
                })
                .to_vec(),
            audio: FORMATS.to_vec(),
            limits: Bounds {
                memory_per_request_bytes: limits.memory_per_request(),
                limits: limits.clone(),
            },
        }
    }
}

impl ModelInfo {
    fn new(manifest: &Manifest, sha256: &str) -> Self {
        let sampling = &manifest.sampling;
        let features = serde_json::to_value(manifest.features.profile).unwrap_or_default();
        Self {
            name: manifest.name.clone(),
            licence: manifest.licence.clone(),
            manifest_sha256: sha256.to_owned(),
            fps: manifest.fps,
            codes_per_second: manifest.codes_per_second(),
            vocabulary: VocabularyInfo {
                upper: manifest.vocabulary.upper,
                lower: manifest.vocabulary.lower,
            },
            styles: manifest.styles.clone(),
            energy: manifest.energy,
            context: manifest.gpt.context,
            sampling: SamplingInfo {
                temperature: sampling.temperature,
                top_k: sampling.top_k,
                guidance: sampling.guidance,
                candidates: sampling.candidates,
                redo: sampling.redo || sampling.candidates > 1,
                window: match sampling.window {
                    WindowKind::Hop => "hop",
                    WindowKind::Sliding => "sliding",
                },
                hop: sampling.hop,
            },
            features: features.as_str().unwrap_or_default().to_owned(),
            skeleton: SkeletonInfo {
                joints: manifest.skeleton.joints.clone(),
                parents: manifest.skeleton.parents.clone(),
                offsets: manifest.skeleton.offsets.clone(),
            },
        }
    }
}
