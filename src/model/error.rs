//! What can be wrong with a model directory or with ONNX Runtime.

use std::path::PathBuf;

/// What can be wrong with a model directory or with ONNX Runtime.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// A file could not be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}
