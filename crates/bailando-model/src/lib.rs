//! Model directory, manifest and ONNX sessions: the only place that knows ONNX Runtime.

mod directory;
mod embedded;
mod error;
mod gpt;
mod manifest;
mod memory;
mod runtime;
mod session;
mod suppressed;
mod vqvae;

pub use directory::{ModelDirectory, file_sha256};
pub use error::ModelError;
pub use gpt::{Gpt, KvCache, Logits, NextStep, Steps};
pub use manifest::{
    DecoderSpec, FORMAT_VERSION, FeatureSpec, FileEntry, GptSpec, MAX_CANDIDATES,
    MAX_COUNT_PERIODS, MAX_GUIDANCE, MAX_TEMPERATURE, Manifest, SamplingDefaults, Vocabulary,
    WeightStorage, WindowKind,
};
pub use memory::GptMemory;
pub use runtime::LIBRARY_VARIABLE;
pub use suppressed::SuppressedCodes;
pub use vqvae::{Decoder, Encoder};

/// Whether a graph passes the checks of a model directory; for the fuzz target `graph`.
#[doc(hidden)]
#[must_use]
pub fn graph_is_accepted(bytes: &[u8]) -> bool {
    embedded::check_bytes(std::io::Cursor::new(bytes), bytes.len() as u64).is_ok()
}
