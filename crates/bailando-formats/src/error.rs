//! Why a result could not be written.

/// Why a result could not be written.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// The wanted format does not exist.
    #[error("format {got:?} is not available: choose json or bvh")]
    Unknown {
        /// What was asked for.
        got: String,
    },
    /// A choice about a format does not exist.
    #[error("{name} {got:?} is not available: choose {accepted}")]
    Choice {
        /// Name of the option as in the API.
        name: &'static str,
        /// What was asked for.
        got: String,
        /// What there is.
        accepted: &'static str,
    },
    /// A text is no end of a dance.
    #[error("this is not the `tail` of a dance")]
    Tail,
    /// The dance contradicts itself, so that no file could be right.
    #[error("the dance can't be written: {0}")]
    Inconsistent(String),
    /// JSON could not be written.
    #[error("the result could not be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// BVH could not be written.
    #[error("the result could not be written as BVH: {0}")]
    Bvh(#[from] std::fmt::Error),
}
