//! Layout of the feature matrix: rates, profiles, and what each column holds.

use std::ops::Range;

use serde::{Deserialize, Serialize};

/// Columns of a feature row.
pub const COLUMNS: usize = 438;
/// Samples from one row to the next, at either rate.
pub const HOP: usize = 512;

/// Columns of the MFCC.
pub const MFCC_COLUMNS: Range<usize> = 0..20;
/// Columns of the slopes of the MFCC.
pub const DELTA_COLUMNS: Range<usize> = 20..40;
/// Columns of the chroma, C first.
pub const CHROMA_COLUMNS: Range<usize> = 40..52;
/// Column of the onset strength.
pub const ONSET_COLUMN: usize = 52;
/// Column that is 1 at beats.
pub const BEAT_COLUMN: usize = 53;
/// Columns of the tempogram, by lag in rows.
pub const TEMPOGRAM_COLUMNS: Range<usize> = 54..COLUMNS;

/// The librosa version whose numbers are reproduced (FEATURES sections 1-9 and 11).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Profile {
    /// librosa 0.11.0.
    #[default]
    #[serde(rename = "librosa-0.11")]
    Librosa011,
    /// librosa 0.8.1, which the official code pins.
    #[serde(rename = "librosa-0.8.1")]
    Librosa081,
}

/// One of the two sample rates that the features are defined for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rate {
    /// 3,840 Hz: 7.5 rows a second, one per pose code.
    Conditioning,
    /// 30,720 Hz: 60 rows a second, one per motion frame.
    Beats,
}

impl Rate {
    /// Sample rate in Hz.
    #[must_use]
    pub fn hz(self) -> u32 {
        match self {
            Self::Conditioning => 3_840,
            Self::Beats => 30_720,
        }
    }

    /// Feature rows per second.
    #[must_use]
    pub fn rows_per_second(self) -> f64 {
        f64::from(self.hz()) / HOP as f64
    }
}

/// Feature rows of a signal of `samples` samples.
pub(crate) fn row_count(samples: usize) -> usize {
    1 + samples / HOP
}
