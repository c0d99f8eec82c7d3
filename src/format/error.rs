//! Why a result could not be written.

/// Why a result could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The wanted format does not exist.
    #[error("format {got:?} is not available: choose json or bvh")]
    Unknown {
        /// What was asked for.
        got: String,
    },
    /// JSON could not be written.
    #[error("the result could not be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
}
