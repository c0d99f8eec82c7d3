//! Music as numbers that a model is conditioned on: mono PCM to the 438 feature columns of
//! FEATURES.md, equal to librosa's, and the beats, counts and bars of a song.
//!
//! [`FeatureExtractor`] is planned once for a [`Rate`] and a [`Profile`], then turns songs into
//! matrices of one row per 512 samples. There is one file per stage of FEATURES.md. [`BeatFinder`]
//! finds beats, bars and metre with a network that its caller runs (BEATS.md).
//!
//! ```
//! use bailando_features::{BeatPhase, FeatureExtractor, Profile, Rate, with_counts};
//!
//! # fn main() -> Result<(), bailando_features::FeatureError> {
//! // Four seconds of a note that is struck twice a second.
//! let song = |rate: Rate| -> Vec<f32> {
//!     let hz = rate.hz() as f32;
//!     let samples = (0..4 * rate.hz()).map(|n| n as f32 / hz);
//!     samples.map(|t| (-20.0 * (t % 0.5)).exp() * (1_382.3 * t).sin()).collect()
//! };
//!
//! // 7.5 rows a second: the rows that the model is conditioned on.
//! let mut extractor = FeatureExtractor::new(Rate::Conditioning, Profile::Librosa011);
//! let rows = extractor.extract(&song(Rate::Conditioning))?;
//! assert_eq!(rows.dim(), (31, 438));
//!
//! // 60 rows a second: tempo and beats.
//! let beats = FeatureExtractor::new(Rate::Beats, Profile::Librosa011).beats(&song(Rate::Beats))?;
//! assert!((beats.tempo_bpm - 120.0).abs() < 3.0);
//!
//! // Sine and cosine of the place within a count and within the dancer's eight.
//! let counts = BeatPhase::find(&beats, rows.view());
//! assert!(counts.is_some());
//! assert_eq!(with_counts(rows, counts.as_ref(), 0.0, &[1, 8]).ncols(), 438 + 4);
//! # Ok(())
//! # }
//! ```

mod beat;
mod beats;
mod chain;
mod chroma;
mod cqt;
mod cqt_basis;
mod decibel;
mod decimate;
mod error;
mod extractor;
mod fft;
mod form;
mod halves;
mod hpss;
mod istft;
mod layout;
mod median;
mod mel;
mod mfcc;
mod novelty;
mod onset;
mod padding;
mod phase;
mod settings;
mod stft;
mod tempo;
mod tempogram;
mod tuning;

pub use self::{
    beat::Beats,
    beats::{BeatFinder, SongBeats},
    error::FeatureError,
    extractor::{FeatureExtractor, Stages},
    form::{Phrases, Return, SelfSimilarity, returns},
    layout::{
        BEAT_COLUMN, CHROMA_COLUMNS, COLUMNS, DELTA_COLUMNS, HOP, MFCC_COLUMNS, ONSET_COLUMN,
        Profile, Rate, TEMPOGRAM_COLUMNS,
    },
    phase::{BeatPhase, with_counts},
};
