//! Model directory, manifest and ONNX sessions: the only place that knows ONNX Runtime.
//!
//! ```
//! use bailando_model::ModelDirectory;
//!
//! let directory = ModelDirectory::open("../../models/default".as_ref())?;
//! let manifest = directory.manifest();
//! assert_eq!(manifest.codes_per_second(), 7.5);
//! # Ok::<(), bailando_model::ModelError>(())
//! ```
//!
//! [`ModelDirectory`] then opens the graphs: [`Gpt`] with its [`KvCache`], [`Decoder`] and
//! [`Encoder`]. [`BeatNetwork`] belongs to no directory: it is part of the program.

#[cfg(test)]
mod batch_tests;
mod beats;
mod cache;
mod cuda;
mod device;
mod directory;
mod embedded;
mod error;
mod gpt;
mod installed;
mod manifest;
mod manner;
mod runtime;
mod session;
mod song_statistics;
mod style_classifier;
mod vocabulary;
mod vqvae;

pub use beats::{BeatActivations, BeatNetwork};
pub use cache::KvCache;
pub use device::Device;
pub use directory::{ModelDirectory, file_sha256};
pub use error::ModelError;
pub use gpt::{Gpt, Logits, NextStep, Steps};
pub use manifest::{
    CountSource, DecoderSpec, FORMAT_VERSION, FeatureSpec, FileEntry, GptSpec, MAX_CANDIDATES,
    MAX_COUNT_PERIODS, MAX_GUIDANCE, MAX_TEMPERATURE, Manifest, SamplingDefaults, WeightStorage,
    WindowKind,
};
pub use manner::{MAX_STYLES, Manner, MannerSpec, NO_STYLE, check_styles};
pub use runtime::LIBRARY_VARIABLE;
pub use song_statistics::{STATISTICS, song_statistics};
pub use style_classifier::{STYLES_FILE, StyleClassifier, root_mean_square};
pub use vocabulary::{StyleCodes, SuppressedCodes, Vocabulary};
pub use vqvae::{Decoder, Encoder, code_pairs};

/// Whether a graph passes the checks of a model directory; for the fuzz target `graph`.
#[doc(hidden)]
#[must_use]
pub fn graph_is_accepted(bytes: &[u8]) -> bool {
    embedded::check_bytes(std::io::Cursor::new(bytes), bytes.len() as u64).is_ok()
}
