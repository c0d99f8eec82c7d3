//! PCM to the 438 music feature columns of FEATURES.md; one file per stage.

mod beat;
mod chain;
mod chroma;
mod cqt;
mod cqt_basis;
mod decibel;
mod decimate;
mod error;
mod fft;
mod halves;
mod hpss;
mod istft;
mod median;
mod mel;
mod mfcc;
mod onset;
mod padding;
mod phase;
mod settings;
mod stft;
mod tempo;
mod tempogram;
mod tuning;

use std::{fmt, ops::Range};

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use self::{chain::Chain, settings::Settings};
pub use self::{
    error::FeatureError,
    phase::{BeatPhase, with_counts, with_counts_of},
};
use bailando_core::CancelToken;

/// Columns of a feature row.
pub const COLUMNS: usize = 438;
/// Samples between two rows, at either rate.
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

// The slopes need a neighbour on both sides.
const MIN_ROWS: usize = 3;
// Beyond any sound; the power of a full-scale frame still fits f32.
const LOUDEST: f32 = 1e15;

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

impl Beats {
    /// Seconds of the beats, where they were tracked at [`Rate::Beats`].
    pub fn seconds(&self) -> impl Iterator<Item = f64> + '_ {
        let a_second = Rate::Beats.rows_per_second();
        self.frames
            .iter()
            .map(move |&frame| frame as f64 / a_second)
    }
}

/// Every stage of the chain on one song; `T` rows.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Stages {
    /// Mel spectrum of the signal in dB below its maximum, `[T, 128]`, -80..=0 (section 3).
    pub mel_db: Array2<f32>,
    /// Harmonic part of the signal, as long as the signal (section 4).
    pub harmonic: Vec<f32>,
    /// Percussive part of the signal, as long as the signal (section 4).
    pub percussive: Vec<f32>,
    /// Tuning of the harmonic part, a fraction of a 36th of an octave (section 5).
    pub tuning: f64,
    /// Constant-Q magnitudes of the harmonic part, `[T, 180]` or `[T, 252]` (section 6).
    pub cqt: Array2<f32>,
    /// Tempo and beats (section 9).
    pub beats: Beats,
    /// The feature matrix, `[T, 438]`: the other stages are its columns.
    pub features: Array2<f32>,
}

/// Computes features at one rate and profile: tables and transforms are planned once in
/// [`FeatureExtractor::new`].
///
/// A song is one call: decibels, tuning, tempo and beats depend on the whole of it.
pub struct FeatureExtractor {
    rate: Rate,
    profile: Profile,
    chain: Chain,
}

impl FeatureExtractor {
    /// Plans the chain.
    #[must_use]
    pub fn new(rate: Rate, profile: Profile) -> Self {
        Self {
            rate,
            profile,
            chain: Chain::new(Settings::new(rate, profile)),
        }
    }

    /// The sample rate this extractor was planned for.
    #[must_use]
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// The profile this extractor was planned for.
    #[must_use]
    pub fn profile(&self) -> Profile {
        self.profile
    }

    /// The `[T, 438]` feature matrix of `pcm` (mono, at this extractor's rate), `T = 1 + floor(N / 512)`.
    ///
    /// # Errors
    /// [`FeatureError::TooShort`] for fewer than 3 rows, [`FeatureError::NotFinite`] and
    /// [`FeatureError::OutOfRange`] for samples that are no sound.
    pub fn extract(&mut self, pcm: &[f32]) -> Result<Array2<f32>, FeatureError> {
        self.extract_until(pcm, &CancelToken::new())
    }

    /// [`FeatureExtractor::extract`] that stops within a few frames once `cancel` is triggered.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`], and [`FeatureError::Cancelled`].
    pub fn extract_until(
        &mut self,
        pcm: &[f32],
        cancel: &CancelToken,
    ) -> Result<Array2<f32>, FeatureError> {
        self.chain.cancel = cancel.clone();
        let mut features = self.blank_features(pcm)?;
        // Each stage's own result is dropped as soon as the columns hold what they need of it.
        let (split, mel_db) = self.chain.split(pcm);
        self.chain.timbre(&mel_db, &mut features);
        drop(mel_db);
        self.chain.rhythm(&split.percussive, &mut features);
        drop(split.percussive);
        self.chain.harmony(&split.harmonic, &mut features);
        finished(cancel)?;
        Ok(features)
    }

    /// As [`FeatureExtractor::extract`], with all that lies between.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`].
    pub fn extract_stages(&mut self, pcm: &[f32]) -> Result<Stages, FeatureError> {
        self.chain.cancel = CancelToken::new();
        let mut features = self.blank_features(pcm)?;
        let (split, mel_db) = self.chain.split(pcm);
        self.chain.timbre(&mel_db, &mut features);
        let beats = self.chain.rhythm(&split.percussive, &mut features);
        let (tuning, cqt) = self.chain.harmony(&split.harmonic, &mut features);
        Ok(Stages {
            mel_db,
            harmonic: split.harmonic,
            percussive: split.percussive,
            tuning,
            cqt,
            beats,
            features,
        })
    }

    /// Tempo and beats alone: skips everything that only the other columns need.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`].
    pub fn beats(&mut self, pcm: &[f32]) -> Result<Beats, FeatureError> {
        self.beats_until(pcm.to_vec(), &CancelToken::new())
    }

    /// [`FeatureExtractor::beats`] without a copy of `pcm`, in whose place it works: at [`Rate::Beats`] ten minutes are
    /// 74 MB. It stops within a few frames once `cancel` is triggered.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract_until`].
    pub fn beats_until(
        &mut self,
        mut pcm: Vec<f32>,
        cancel: &CancelToken,
    ) -> Result<Beats, FeatureError> {
        check(&pcm)?;
        self.chain.cancel = cancel.clone();
        self.chain.percussive(&mut pcm);
        finished(cancel)?;
        let onset = self.chain.onset(&pcm);
        drop(pcm);
        let beats = self.chain.beats(&onset);
        finished(cancel)?;
        Ok(beats)
    }

    /// Tempo and beats of a given onset envelope (column 52), `[T]`.
    pub fn beats_of_onset(&mut self, onset: &[f32]) -> Beats {
        self.chain.cancel = CancelToken::new();
        self.chain.beats(onset)
    }

    /// Spectral magnitudes of the first `rows` frames, `[min(rows, T), 1025]` (section 2).
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`].
    pub fn stft_magnitudes(
        &mut self,
        pcm: &[f32],
        rows: usize,
    ) -> Result<Array2<f32>, FeatureError> {
        check(pcm)?;
        Ok(self.chain.stft_magnitudes(pcm, rows))
    }

    /// Constant-Q magnitudes `[T, 180]` or `[T, 252]` of `signal` for a given tuning, a fraction
    /// of a bin in [-0.5, 0.5] (section 6).
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`].
    pub fn cqt(&mut self, signal: &[f32], tuning: f64) -> Result<Array2<f32>, FeatureError> {
        check(signal)?;
        self.chain.cancel = CancelToken::new();
        Ok(self.chain.cqt(signal, tuning.clamp(-0.5, 0.5)))
    }

    fn blank_features(&self, pcm: &[f32]) -> Result<Array2<f32>, FeatureError> {
        check(pcm)?;
        Ok(Array2::zeros((row_count(pcm.len()), COLUMNS)))
    }
}

impl fmt::Debug for FeatureExtractor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FeatureExtractor")
            .field("rate", &self.rate)
            .field("profile", &self.profile)
            .finish_non_exhaustive()
    }
}

/// What was computed is whole unless it was cancelled meanwhile: stages then leave off where they are.
fn finished(cancel: &CancelToken) -> Result<(), FeatureError> {
    match cancel.is_cancelled() {
        true => Err(FeatureError::Cancelled),
        false => Ok(()),
    }
}

/// Feature rows of a signal of `samples` samples.
fn row_count(samples: usize) -> usize {
    1 + samples / HOP
}

fn check(pcm: &[f32]) -> Result<(), FeatureError> {
    let rows = row_count(pcm.len());
    if rows < MIN_ROWS {
        return Err(FeatureError::TooShort {
            rows,
            needed: MIN_ROWS,
        });
    }
    let is_sound = |sample: &f32| (-LOUDEST..=LOUDEST).contains(sample);
    match pcm.iter().position(|sample| !is_sound(sample)) {
        None => Ok(()),
        Some(index) if pcm[index].is_finite() => Err(FeatureError::OutOfRange {
            index,
            value: pcm[index],
        }),
        Some(index) => Err(FeatureError::NotFinite { index }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extractor() -> FeatureExtractor {
        FeatureExtractor::new(Rate::Conditioning, Profile::Librosa011)
    }

    #[test]
    fn fewer_than_three_rows_are_refused() {
        let too_short = |rows| FeatureError::TooShort { rows, needed: 3 };
        assert_eq!(extractor().extract(&[0.1; 1_023]), Err(too_short(2)));
        assert_eq!(extractor().extract(&[]), Err(too_short(1)));
        assert_eq!(extractor().beats(&[0.1; 511]), Err(too_short(1)));
        assert_eq!(extractor().cqt(&[0.1; 511], 0.0), Err(too_short(1)));
        let features = extractor().extract(&[0.1; 1_024]).unwrap();
        assert_eq!(features.dim(), (3, COLUMNS));
    }

    #[test]
    fn samples_that_are_no_sound_are_refused_by_index() {
        for (sample, expected) in [
            (f32::NAN, FeatureError::NotFinite { index: 700 }),
            (f32::NEG_INFINITY, FeatureError::NotFinite { index: 700 }),
            (
                -1e30,
                FeatureError::OutOfRange {
                    index: 700,
                    value: -1e30,
                },
            ),
        ] {
            let mut pcm = vec![0.0; 4_000];
            pcm[700] = sample;
            assert_eq!(extractor().extract(&pcm), Err(expected.clone()));
            assert_eq!(extractor().beats(&pcm), Err(expected));
        }
    }

    #[test]
    fn the_loudest_and_the_faintest_signals_stay_finite() {
        for profile in [Profile::Librosa011, Profile::Librosa081] {
            for level in [LOUDEST, 1e-30, f32::MIN_POSITIVE / 8.0] {
                let pcm: Vec<f32> = (0..9_000).map(|i| level * (i as f32 * 0.7).sin()).collect();
                let features = FeatureExtractor::new(Rate::Beats, profile)
                    .extract(&pcm)
                    .unwrap();
                assert!(
                    features.iter().all(|x| x.is_finite()),
                    "{profile:?} {level}"
                );
            }
        }
    }

    #[test]
    fn an_extractor_keeps_nothing_of_the_song_before() {
        let song: Vec<f32> = (0..40_000)
            .map(|i| (i as f32 * 0.05).sin() * if i % 4_000 < 400 { 1.0 } else { 0.1 })
            .collect();
        let mut used = extractor();
        used.extract(&song[..30_000]).unwrap();
        used.beats(&song[..20_000]).unwrap();
        let fresh = extractor().extract(&song).unwrap();
        assert_eq!(used.extract(&song).unwrap(), fresh);
    }
}
