//! PCM to the 438 music feature columns of FEATURES.md; one file per stage.

mod error;

pub use error::FeatureError;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

/// Columns of a feature row.
pub const COLUMNS: usize = 438;
/// Samples between two rows, at either rate.
pub const HOP: usize = 512;

/// Which librosa version's numbers are reproduced (FEATURES sections 1-9 and 11).
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

/// The two sample rates that the chain is defined for.
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

/// Tempo and beats of a song.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Beats {
    /// Beats per minute; 0 when the onset envelope is silent.
    pub tempo_bpm: f64,
    /// Row indices of the beats (column 53), ascending.
    pub frames: Vec<usize>,
}

/// Computes features at one rate and profile: tables and transforms are planned once in
/// [`FeatureExtractor::new`].
#[derive(Debug)]
pub struct FeatureExtractor {
    _rate: Rate,
    _profile: Profile,
}

impl FeatureExtractor {
    /// Plans the chain.
    #[must_use]
    pub fn new(rate: Rate, profile: Profile) -> Self {
        Self {
            _rate: rate,
            _profile: profile,
        }
    }

    /// The `[T, 438]` feature matrix of `pcm` (mono, at this extractor's rate), `T = 1 + floor(N / 512)`.
    ///
    /// # Errors
    /// [`FeatureError::TooShort`] for fewer than 3 rows.
    pub fn extract(&mut self, _pcm: &[f32]) -> Result<Array2<f32>, FeatureError> {
        Err(FeatureError::TooShort { rows: 0, needed: 3 })
    }

    /// Tempo and beats alone: skips everything that only the other columns need.
    ///
    /// # Errors
    /// [`FeatureError::TooShort`] for fewer than 3 rows.
    pub fn beats(&mut self, _pcm: &[f32]) -> Result<Beats, FeatureError> {
        Err(FeatureError::TooShort { rows: 0, needed: 3 })
    }
}
