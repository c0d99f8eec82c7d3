//! Model directory, manifest and ONNX sessions: the only place that knows ONNX Runtime.

mod error;
mod manifest;

pub use error::ModelError;
pub use manifest::{
    DecoderSpec, FORMAT_VERSION, FeatureSpec, FileEntry, GptSpec, Manifest, SamplingDefaults,
    Vocabulary, WeightStorage, WindowKind,
};
