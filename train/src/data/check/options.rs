//! Extent of the checks.

use clap::Args;

use crate::data::OpenOptions;

/// Extent of the checks.
#[derive(Args, Clone, Debug)]
pub struct CheckOptions {
    /// Facts that the folder does not hold.
    #[command(flatten)]
    pub open: OpenOptions,
    /// Decode only N songs, spread evenly [default: all]
    #[arg(long, value_name = "N")]
    pub songs: Option<usize>,
    /// Find the beats of N songs and compare them with the data's own
    #[arg(long, default_value_t = Self::default().beats, value_name = "N")]
    pub beats: usize,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self { open: OpenOptions::default(), songs: None, beats: 8 }
    }
}
