//! The public face of the chain: songs in, matrices, beats or single stages out.

use std::fmt;

use bailando_core::CancelToken;
use ndarray::Array2;

use crate::{
    beat::Beats,
    chain::Chain,
    error::FeatureError,
    layout::{COLUMNS, Profile, Rate, row_count},
    settings::Settings,
};

// The slopes need a neighbour on both sides.
const MIN_ROWS: usize = 3;
// Beyond any sound; the power of a full-scale frame still fits f32.
const LOUDEST: f32 = 1e15;

/// Every stage of the chain for one song; `T` rows.
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

/// An extractor of features at one rate and profile: [`FeatureExtractor::new`] plans all tables and
/// transforms.
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
        let chain = Chain::new(Settings::new(rate, profile));
        Self { rate, profile, chain }
    }

    /// Returns the sample rate that this extractor was planned for.
    #[must_use]
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// Returns the profile that this extractor was planned for.
    #[must_use]
    pub fn profile(&self) -> Profile {
        self.profile
    }

    /// Computes the `[T, 438]` feature matrix of `pcm` (mono, at this extractor's rate), `T = 1 +
    /// floor(N / 512)`.
    ///
    /// # Errors
    /// [`FeatureError::TooShort`] for fewer than 3 rows, [`FeatureError::NotFinite`] and
    /// [`FeatureError::OutOfRange`] for samples that are no sound.
    pub fn extract(&mut self, pcm: &[f32]) -> Result<Array2<f32>, FeatureError> {
        self.extract_until(pcm, &CancelToken::new())
    }

    /// Does as [`FeatureExtractor::extract`], but stops within a few frames once `cancel` is
    /// triggered.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`], and [`FeatureError::Cancelled`].
    pub fn extract_until(
        &mut self,
        pcm: &[f32],
        cancel: &CancelToken,
    ) -> Result<Array2<f32>, FeatureError> {
        let mut features = blank_features(pcm)?;
        // Each stage's own result is dropped as soon as the columns hold what they need of it.
        let (split, mel_db) = self.chain.split(pcm, cancel);
        self.chain.timbre(&mel_db, &mut features);
        drop(mel_db);
        self.chain.rhythm(&split.percussive, &mut features, cancel);
        drop(split.percussive);
        self.chain.harmony(&split.harmonic, &mut features, cancel);
        unless_cancelled(features, cancel)
    }

    /// Does as [`FeatureExtractor::extract`] and keeps the results of all stages.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`].
    pub fn extract_stages(&mut self, pcm: &[f32]) -> Result<Stages, FeatureError> {
        let cancel = &CancelToken::new();
        let mut features = blank_features(pcm)?;
        let (split, mel_db) = self.chain.split(pcm, cancel);
        self.chain.timbre(&mel_db, &mut features);
        let beats = self.chain.rhythm(&split.percussive, &mut features, cancel);
        let (tuning, cqt) = self.chain.harmony(&split.harmonic, &mut features, cancel);
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

    /// Finds tempo and beats alone, without the stages that only the other columns need.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`].
    pub fn beats(&mut self, pcm: &[f32]) -> Result<Beats, FeatureError> {
        self.beats_until(pcm.to_vec(), &CancelToken::new())
    }

    /// Does as [`FeatureExtractor::beats`] without a copy of `pcm`, in whose place it works: at
    /// [`Rate::Beats`] ten minutes are 74 MB. Stops within a few frames once `cancel` is triggered.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract_until`].
    pub fn beats_until(
        &mut self,
        mut pcm: Vec<f32>,
        cancel: &CancelToken,
    ) -> Result<Beats, FeatureError> {
        check(&pcm)?;
        self.chain.percussive(&mut pcm, cancel);
        unless_cancelled((), cancel)?;
        let onset = self.chain.onset(&pcm);
        drop(pcm);
        unless_cancelled(self.chain.beats(&onset, cancel), cancel)
    }

    /// Finds tempo and beats of a given onset envelope (column 52), `[T]`.
    pub fn beats_of_onset(&mut self, onset: &[f32]) -> Beats {
        self.chain.beats(onset, &CancelToken::new())
    }

    /// Computes the spectral magnitudes of the first `rows` frames, `[min(rows, T), 1025]` (section
    /// 2).
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

    /// Computes the constant-Q magnitudes `[T, 180]` or `[T, 252]` of `signal` for a given tuning,
    /// a fraction of a bin in [-0.5, 0.5] (section 6).
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`].
    pub fn cqt(&mut self, signal: &[f32], tuning: f64) -> Result<Array2<f32>, FeatureError> {
        check(signal)?;
        let tuning = tuning.clamp(-0.5, 0.5);
        Ok(self.chain.cqt(signal, tuning, &CancelToken::new()))
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

fn blank_features(pcm: &[f32]) -> Result<Array2<f32>, FeatureError> {
    check(pcm)?;
    Ok(Array2::zeros((row_count(pcm.len()), COLUMNS)))
}

/// Returns `result`, which is whole unless it was cancelled meanwhile: a cancelled stage stops
/// where it is.
fn unless_cancelled<T>(result: T, cancel: &CancelToken) -> Result<T, FeatureError> {
    match cancel.is_cancelled() {
        true => Err(FeatureError::Cancelled),
        false => Ok(result),
    }
}

fn check(pcm: &[f32]) -> Result<(), FeatureError> {
    let rows = row_count(pcm.len());
    if rows < MIN_ROWS {
        return Err(FeatureError::TooShort { rows, needed: MIN_ROWS });
    }
    check_samples(pcm)
}

/// Refuses samples that are no sound.
pub(crate) fn check_samples(pcm: &[f32]) -> Result<(), FeatureError> {
    let is_sound = |sample: &f32| (-LOUDEST..=LOUDEST).contains(sample);
    match pcm.iter().copied().enumerate().find(|(_, x)| !is_sound(x)) {
        None => Ok(()),
        Some((index, value)) if value.is_finite() => Err(FeatureError::OutOfRange { index, value }),
        Some((index, _)) => Err(FeatureError::NotFinite { index }),
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
        let (index, value) = (700, -1e30);
        for (sample, expected) in [
            (f32::NAN, FeatureError::NotFinite { index }),
            (f32::NEG_INFINITY, FeatureError::NotFinite { index }),
            (value, FeatureError::OutOfRange { index, value }),
        ] {
            let mut pcm = vec![0.0; 4_000];
            pcm[index] = sample;
            assert_eq!(extractor().extract(&pcm), Err(expected.clone()));
            assert_eq!(extractor().beats(&pcm), Err(expected));
        }
    }

    #[test]
    fn the_loudest_and_the_faintest_signals_stay_finite() {
        for profile in [Profile::Librosa011, Profile::Librosa081] {
            for level in [LOUDEST, 1e-30, f32::MIN_POSITIVE / 8.0] {
                let pcm: Vec<f32> = (0..9_000).map(|i| level * (i as f32 * 0.7).sin()).collect();
                let features = FeatureExtractor::new(Rate::Beats, profile).extract(&pcm);
                let is_finite = features.unwrap().iter().all(|x| x.is_finite());
                assert!(is_finite, "{profile:?} {level}");
            }
        }
    }

    #[test]
    fn an_extractor_keeps_nothing_of_the_previous_song() {
        let song: Vec<f32> = (0..40_000)
            .map(|i| (i as f32 * 0.05).sin() * if i % 4_000 < 400 { 1.0 } else { 0.1 })
            .collect();
        let mut used = extractor();
        used.extract(&song[..30_000]).unwrap();
        used.beats(&song[..20_000]).unwrap();
        let fresh = extractor().extract(&song).unwrap();
        assert_eq!(used.extract(&song).unwrap(), fresh);
    }

    #[test]
    fn cancelled_work_is_an_error() {
        let (cancel, song) = (CancelToken::new(), vec![0.1; 9_000]);
        cancel.cancel();
        let cancelled = Err(FeatureError::Cancelled);
        assert_eq!(extractor().extract_until(&song, &cancel), cancelled);
        let cancelled = Err(FeatureError::Cancelled);
        assert_eq!(extractor().beats_until(song, &cancel), cancelled);
    }
}
