//! What can be wrong with an upload.

/// What can be wrong with an upload. Messages say what was wrong and what is accepted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AudioError {
    /// The caller no longer wants the result.
    #[error("decoding was cancelled")]
    Cancelled,
}
