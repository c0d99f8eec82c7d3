//! What the service says about itself.

use serde::Serialize;
use utoipa::ToSchema;

use super::{config::Limits, state::Generate};
use crate::{
    audio::Container,
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
    /// Frame rates that a dance can have.
    frame_rates: [u32; 4],
    /// Formats of a dance, the default first.
    formats: [FormatInfo; 2],
    /// Audio that is accepted.
    #[schema(example = json!(["wav", "flac"]))]
    audio: Vec<&'static str>,
    limits: Bounds,
}

/// Every limit, and what follows from them.
#[derive(Clone, Debug, Serialize, ToSchema)]
struct Bounds {
    #[serde(flatten)]
    limits: Limits,
    /// Most memory that one request takes while it is worked on: the server as a whole stays below its idle
    /// memory and so much for each of `max_concurrent_requests`, besides uploads and answers that wait.
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
    /// Frames per second that the model itself makes.
    fps: u32,
    /// Pose codes per second of music.
    codes_per_second: f64,
    vocabulary: VocabularyInfo,
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

/// A format of a dance.
#[derive(Clone, Debug, Serialize, ToSchema)]
struct FormatInfo {
    /// Value of the option `format`.
    #[schema(example = "json")]
    name: &'static str,
    #[schema(example = "application/json")]
    content_type: &'static str,
}

impl Info {
    pub(crate) fn new(engine: &dyn Generate, limits: &Limits) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            model: ModelInfo::new(engine.manifest(), engine.model_sha256()),
            frame_rates: FRAME_RATES,
            formats: OutputFormat::ALL.map(|format| FormatInfo {
                name: format.name(),
                content_type: format.content_type(),
            }),
            audio: Container::ALL.map(Container::name).to_vec(),
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
