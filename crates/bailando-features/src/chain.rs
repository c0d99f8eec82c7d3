//! The stages in their order: sound to the columns of the feature matrix.

use std::ops::Range;

use ndarray::{Array2, ArrayViewMut2, Axis, Slice};
use rustfft::num_complex::Complex;

use super::{
    BEAT_COLUMN, Beats, CHROMA_COLUMNS, DELTA_COLUMNS, HOP, MFCC_COLUMNS, ONSET_COLUMN,
    TEMPOGRAM_COLUMNS,
    beat::BeatTracker,
    chroma,
    cqt::Cqt,
    decibel::{Reference, to_decibels},
    halves::Halves,
    mel::{BANDS, MelBank},
    mfcc::{Mfcc, delta},
    onset::Onset,
    row_count,
    settings::Settings,
    stft::{BINS, Stft, magnitudes},
    tempo::TempoEstimator,
    tempogram::Tempogram,
    tuning::Tuner,
};
use bailando_core::CancelToken;

/// The two parts of a signal, as long as it.
pub(super) struct Split {
    pub(super) harmonic: Vec<f32>,
    pub(super) percussive: Vec<f32>,
}

/// All stages, planned.
pub(super) struct Chain {
    halves: Halves,
    mel: MelBank,
    mfcc: Mfcc,
    stft: Stft,
    spectrum: Vec<Complex<f32>>,
    magnitudes: Vec<f32>,
    tuner: Tuner,
    cqt: Cqt,
    onset: Onset,
    tempogram: Tempogram,
    tempo: TempoEstimator,
    beats: BeatTracker,
    /// Once triggered, stages leave off where they are.
    pub(super) cancel: CancelToken,
}

impl Chain {
    pub(super) fn new(settings: Settings) -> Self {
        let Settings {
            sample_rate,
            padding,
            ..
        } = settings;
        Self {
            halves: Halves::new(padding, settings.silent_tail),
            mel: MelBank::new(sample_rate, BINS, sample_rate / 2.0),
            mfcc: Mfcc::new(),
            stft: Stft::hann(padding),
            spectrum: vec![Complex::default(); BINS],
            magnitudes: vec![0.0; BINS],
            tuner: Tuner::new(sample_rate, BINS),
            cqt: Cqt::new(settings.cqt),
            onset: Onset::new(sample_rate, settings.onset_top_hz, padding),
            tempogram: Tempogram::new(TEMPOGRAM_COLUMNS.len()),
            tempo: TempoEstimator::new(settings.rows_per_second),
            beats: BeatTracker::new(settings.beat_rules),
            cancel: CancelToken::new(),
        }
    }

    /// Magnitudes `[rows, 1025]` of the first `rows` frames.
    pub(super) fn stft_magnitudes(&mut self, pcm: &[f32], rows: usize) -> Array2<f32> {
        let mut all = Array2::zeros((rows.min(row_count(pcm.len())), BINS));
        for (row, mut stored) in all.rows_mut().into_iter().enumerate() {
            self.analyse(pcm, row);
            for (stored, &magnitude) in stored.iter_mut().zip(&self.magnitudes) {
                *stored = magnitude;
            }
        }
        all
    }

    /// Both parts of the signal, and the mel decibels `[T, 128]` of the whole.
    pub(super) fn split(&mut self, pcm: &[f32]) -> (Split, Array2<f32>) {
        let rows = row_count(pcm.len());
        let mut mel = Array2::zeros((rows, BANDS));
        let bank = &self.mel;
        let cancel = &self.cancel;
        let mut split = Split {
            harmonic: vec![0.0; pcm.len()],
            percussive: pcm.to_vec(),
        };
        let harmonic = Some(split.harmonic.as_mut_slice());
        let separator = self.halves.alone();
        separator.split(&mut split.percussive, harmonic, |row, magnitudes| {
            bank.power(magnitudes, mel.row_mut(row));
            !cancel.is_cancelled()
        });
        to_decibels(&mut mel, Reference::Maximum);
        (split, mel)
    }

    /// The percussive part alone, in the place of the whole, on two threads.
    pub(super) fn percussive(&mut self, signal: &mut [f32]) {
        let cancel = &self.cancel;
        self.halves.percussive(signal, || !cancel.is_cancelled());
    }

    /// Columns 0..40.
    pub(super) fn timbre(&self, mel_db: &Array2<f32>, features: &mut Array2<f32>) {
        let mut cepstrum = Array2::zeros((mel_db.nrows(), MFCC_COLUMNS.len()));
        for (mel_db, mut cepstrum) in mel_db.rows().into_iter().zip(cepstrum.rows_mut()) {
            self.mfcc.frame(&mel_db, cepstrum.iter_mut());
        }
        columns(features, MFCC_COLUMNS).assign(&cepstrum);
        delta(&cepstrum, &mut columns(features, DELTA_COLUMNS));
    }

    /// Columns 40..52, and the tuning and constant-Q magnitudes that they come from.
    pub(super) fn harmony(
        &mut self,
        harmonic: &[f32],
        features: &mut Array2<f32>,
    ) -> (f64, Array2<f32>) {
        let tuning = self.tuning(harmonic);
        let cqt = self.cqt(harmonic, tuning);
        let mut columns = columns(features, CHROMA_COLUMNS);
        for (cqt, mut chroma) in cqt.rows().into_iter().zip(columns.rows_mut()) {
            chroma::frame(cqt.iter(), chroma.iter_mut());
        }
        (tuning, cqt)
    }

    fn tuning(&mut self, harmonic: &[f32]) -> f64 {
        self.tuner.start();
        for row in 0..row_count(harmonic.len()) {
            if self.cancel.is_cancelled() {
                break;
            }
            self.analyse(harmonic, row);
            self.tuner.observe(&self.magnitudes);
        }
        self.tuner.estimate()
    }

    /// Constant-Q magnitudes `[T, bins]`.
    pub(super) fn cqt(&mut self, harmonic: &[f32], tuning: f64) -> Array2<f32> {
        let cancel = &self.cancel;
        self.cqt
            .magnitudes(harmonic, tuning, || !cancel.is_cancelled())
    }

    /// Columns 52..438, and the beats.
    pub(super) fn rhythm(&mut self, percussive: &[f32], features: &mut Array2<f32>) -> Beats {
        let onset = self.onset(percussive);
        let beats = self.beats(&onset);
        for (feature, &strength) in features.column_mut(ONSET_COLUMN).iter_mut().zip(&onset) {
            *feature = strength;
        }
        for &beat in &beats.frames {
            features[[beat, BEAT_COLUMN]] = 1.0;
        }
        let mut columns = columns(features, TEMPOGRAM_COLUMNS);
        let cancel = &self.cancel;
        self.tempogram.for_each_row(&onset, |row, lags| {
            for (feature, &lag) in columns.row_mut(row).iter_mut().zip(lags) {
                *feature = lag as f32;
            }
            !cancel.is_cancelled()
        });
        beats
    }

    /// Onset envelope of the percussive part.
    pub(super) fn onset(&mut self, percussive: &[f32]) -> Vec<f32> {
        self.onset.envelope(percussive)
    }

    /// Tempo and beats of an onset envelope.
    pub(super) fn beats(&mut self, onset: &[f32]) -> Beats {
        let cancel = &self.cancel;
        match self.tempo.estimate(onset, || !cancel.is_cancelled()) {
            None => Beats::default(),
            Some(tempo) => Beats {
                tempo_bpm: tempo.bpm,
                frames: self.beats.track(onset, tempo.period),
            },
        }
    }

    fn analyse(&mut self, signal: &[f32], row: usize) {
        self.stft.frame(signal, row * HOP, &mut self.spectrum);
        magnitudes(&self.spectrum, &mut self.magnitudes);
    }
}

fn columns(features: &mut Array2<f32>, range: Range<usize>) -> ArrayViewMut2<'_, f32> {
    features.slice_axis_mut(Axis(1), Slice::from(range))
}
