//! What is said of a rig that cannot be used.

use crate::error::FormatError;

/// Refuses a rig for this problem.
pub(super) fn problem<T>(problem: impl Into<String>) -> Result<T, FormatError> {
    Err(FormatError::Rig(problem.into()))
}

/// Returns the beginning of a text of the file or the caller, for an error.
pub(super) fn short(text: &str) -> String {
    const LONGEST: usize = 60;
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}..", &text[..end]),
        None => text.to_owned(),
    }
}
