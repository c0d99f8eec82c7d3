//! The stages in their order: sound to the columns of the feature matrix.

use std::ops::Range;

use bailando_core::CancelToken;
use ndarray::{Array2, ArrayViewMut2, Axis, Slice, aview1};

use crate::{
    beat::{BeatTracker, Beats},
    chroma,
    cqt::Cqt,
    decibel::{Reference, to_decibels},
    halves::Halves,
    layout::{
        BEAT_COLUMN, CHROMA_COLUMNS, DELTA_COLUMNS, MFCC_COLUMNS, ONSET_COLUMN, TEMPOGRAM_COLUMNS,
        row_count,
    },
    mel::{BANDS, MelBank},
    mfcc::{Mfcc, delta},
    onset::Onset,
    settings::Settings,
    stft::{BINS, MagnitudeFrames},
    tempo::TempoEstimator,
    tempogram::Tempogram,
    tuning::Tuner,
};

/// The two parts of a signal, as long as it.
pub(crate) struct Split {
    pub(crate) harmonic: Vec<f32>,
    pub(crate) percussive: Vec<f32>,
}

/// All stages, planned. Once a stage's token is cancelled, it stops where it is and its result is
/// worthless.
pub(crate) struct Chain {
    halves: Halves,
    mel: MelBank,
    mfcc: Mfcc,
    frames: MagnitudeFrames,
    tuner: Tuner,
    cqt: Cqt,
    onset: Onset,
    tempogram: Tempogram,
    tempo: TempoEstimator,
    beats: BeatTracker,
}

impl Chain {
    pub(crate) fn new(settings: Settings) -> Self {
        let Settings { sample_rate, padding, .. } = settings;
        Self {
            halves: Halves::new(padding, settings.silent_tail),
            mel: MelBank::new(sample_rate, BINS, sample_rate / 2.0),
            mfcc: Mfcc::new(),
            frames: MagnitudeFrames::new(padding),
            tuner: Tuner::new(sample_rate, BINS),
            cqt: Cqt::new(settings.cqt),
            onset: Onset::new(sample_rate, settings.onset_top_hz, padding),
            tempogram: Tempogram::new(TEMPOGRAM_COLUMNS.len()),
            tempo: TempoEstimator::new(settings.rows_per_second),
            beats: BeatTracker::new(settings.beat_rules),
        }
    }

    /// Magnitudes `[rows, 1025]` of the first `rows` frames.
    pub(crate) fn stft_magnitudes(&mut self, pcm: &[f32], rows: usize) -> Array2<f32> {
        let mut all = Array2::zeros((rows.min(row_count(pcm.len())), BINS));
        for (row, mut stored) in all.rows_mut().into_iter().enumerate() {
            stored.assign(&aview1(self.frames.row(pcm, row)));
        }
        all
    }

    /// Both parts of the signal, and the mel decibels `[T, 128]` of the whole.
    pub(crate) fn split(&mut self, pcm: &[f32], cancel: &CancelToken) -> (Split, Array2<f32>) {
        let mut mel = Array2::zeros((row_count(pcm.len()), BANDS));
        let mut split = Split { harmonic: vec![0.0; pcm.len()], percussive: pcm.to_vec() };
        let harmonic = Some(split.harmonic.as_mut_slice());
        let (bank, separator) = (&self.mel, self.halves.single());
        separator.split(&mut split.percussive, harmonic, cancel, |row, magnitudes| {
            bank.power(magnitudes, mel.row_mut(row));
        });
        to_decibels(&mut mel, Reference::Maximum);
        (split, mel)
    }

    /// Leaves the percussive part in the place of the signal; two threads work on it.
    pub(crate) fn percussive(&mut self, signal: &mut [f32], cancel: &CancelToken) {
        self.halves.percussive(signal, cancel);
    }

    /// Fills columns 0..40.
    pub(crate) fn timbre(&self, mel_db: &Array2<f32>, features: &mut Array2<f32>) {
        let mut cepstrum = Array2::zeros((mel_db.nrows(), MFCC_COLUMNS.len()));
        for (mel_db, mut cepstrum) in mel_db.rows().into_iter().zip(cepstrum.rows_mut()) {
            self.mfcc.frame(&mel_db, cepstrum.iter_mut());
        }
        columns(features, MFCC_COLUMNS).assign(&cepstrum);
        delta(&cepstrum, &mut columns(features, DELTA_COLUMNS));
    }

    /// Fills columns 40..52; returns the tuning and the constant-Q magnitudes that they come from.
    pub(crate) fn harmony(
        &mut self,
        harmonic: &[f32],
        features: &mut Array2<f32>,
        cancel: &CancelToken,
    ) -> (f64, Array2<f32>) {
        let tuning = self.tuning(harmonic, cancel);
        let cqt = self.cqt(harmonic, tuning, cancel);
        let mut columns = columns(features, CHROMA_COLUMNS);
        for (cqt, mut chroma) in cqt.rows().into_iter().zip(columns.rows_mut()) {
            chroma::frame(cqt.iter(), chroma.iter_mut());
        }
        (tuning, cqt)
    }

    fn tuning(&mut self, harmonic: &[f32], cancel: &CancelToken) -> f64 {
        self.tuner.start();
        for row in (0..row_count(harmonic.len())).take_while(|_| !cancel.is_cancelled()) {
            self.tuner.observe(self.frames.row(harmonic, row));
        }
        self.tuner.estimate()
    }

    /// Constant-Q magnitudes `[T, bins]`.
    pub(crate) fn cqt(
        &mut self,
        harmonic: &[f32],
        tuning: f64,
        cancel: &CancelToken,
    ) -> Array2<f32> {
        self.cqt.magnitudes(harmonic, tuning, cancel)
    }

    /// Fills columns 52..438; returns the beats.
    pub(crate) fn rhythm(
        &mut self,
        percussive: &[f32],
        features: &mut Array2<f32>,
        cancel: &CancelToken,
    ) -> Beats {
        let onset = self.onset(percussive);
        let beats = self.beats(&onset, cancel);
        for (feature, &strength) in features.column_mut(ONSET_COLUMN).iter_mut().zip(&onset) {
            *feature = strength;
        }
        for &beat in &beats.frames {
            features[[beat, BEAT_COLUMN]] = 1.0;
        }
        let mut columns = columns(features, TEMPOGRAM_COLUMNS);
        self.tempogram.for_each_row(&onset, cancel, |row, lags| {
            for (feature, &lag) in columns.row_mut(row).iter_mut().zip(lags) {
                *feature = lag as f32;
            }
        });
        beats
    }

    /// Onset envelope of the percussive part.
    pub(crate) fn onset(&mut self, percussive: &[f32]) -> Vec<f32> {
        self.onset.envelope(percussive)
    }

    /// Tempo and beats of an onset envelope.
    pub(crate) fn beats(&mut self, onset: &[f32], cancel: &CancelToken) -> Beats {
        let tempo = self.tempo.estimate(onset, cancel);
        tempo.map_or_else(Beats::default, |tempo| Beats {
            tempo_bpm: tempo.bpm,
            frames: self.beats.track(onset, tempo.period),
        })
    }
}

fn columns(features: &mut Array2<f32>, range: Range<usize>) -> ArrayViewMut2<'_, f32> {
    features.slice_axis_mut(Axis(1), Slice::from(range))
}
