//! Extent of the checks.

use crate::data::OpenOptions;

/// Extent of the checks.
#[derive(Clone, Debug)]
pub struct CheckOptions {
    /// Facts that the folder does not hold.
    pub open: OpenOptions,
    /// Songs that are decoded, spread evenly; all without a number.
    pub songs: Option<usize>,
    /// Of these, songs whose beats are compared with the grid.
    pub beats: usize,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self { open: OpenOptions::default(), songs: None, beats: 8 }
    }
}
