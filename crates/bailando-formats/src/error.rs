//! Why a motion could not be written.

/// The reason why a motion could not be written, or an option about it not be read.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// An option has another value than those it accepts.
    #[error("{name} {got:?} is not available: choose {accepted}")]
    Choice {
        /// Name of the option as in the API.
        name: &'static str,
        /// Value that was asked for.
        got: String,
        /// Values that there are.
        accepted: &'static str,
    },
    /// A text does not describe a continuation.
    #[error("this is not the `tail` of a dance")]
    Continuation,
    /// The motion contradicts itself, so that no file could be right.
    #[error("the dance can't be written: {0}")]
    Inconsistent(String),
    /// JSON could not be written.
    #[error("the result could not be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// BVH could not be written.
    #[error("the result could not be written as BVH: {0}")]
    Bvh(#[from] std::fmt::Error),
}
