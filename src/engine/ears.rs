//! From the bytes of a song to what the model hears of it.

use std::{
    panic,
    sync::{Mutex, PoisonError},
    thread,
};

use bytes::Bytes;
use ndarray::Array2;

use super::EngineError;
use crate::{
    CancelToken, Error, Result,
    audio::{self, AudioError, AudioLimits, AudioRange, DecodedAudio},
    features::{Beats, FeatureError, FeatureExtractor, Profile, Rate, with_counts_of},
};

/// Decoder and feature extractors of one model.
#[derive(Debug)]
pub(crate) struct Ears {
    limits: AudioLimits,
    /// Periods in counts that the model is told its place in.
    count_periods: Vec<u32>,
    conditioning: ExtractorPool,
    beats: ExtractorPool,
}

/// What the model hears.
pub(crate) struct Heard {
    /// Music rows `[rows, columns]`.
    pub(crate) rows: Array2<f32>,
    /// Tempo and beats, where they were wanted.
    pub(crate) beats: Option<Beats>,
}

impl Ears {
    pub(crate) fn new(profile: Profile, count_periods: Vec<u32>, limits: AudioLimits) -> Self {
        Self {
            limits,
            count_periods,
            conditioning: ExtractorPool::new(Rate::Conditioning, profile),
            // Beats for people are those of the current profile, whatever the model hears.
            beats: ExtractorPool::new(Rate::Beats, Profile::Librosa011),
        }
    }

    /// Decodes what the features need.
    pub(crate) fn decode(
        &self,
        audio: Bytes,
        range: AudioRange,
        with_beats: bool,
        cancel: &CancelToken,
    ) -> Result<DecodedAudio> {
        let both = [Rate::Conditioning.hz(), Rate::Beats.hz()];
        let rates = if self.needs_beats(with_beats) {
            &both[..]
        } else {
            &both[..1]
        };
        audio::decode(audio, range, rates, &self.limits, cancel).map_err(|error| match error {
            AudioError::Cancelled => EngineError::Cancelled.into(),
            other => Error::from(other),
        })
    }

    /// Music rows of the signals of decoded audio, and its beats.
    pub(crate) fn listen(
        &self,
        signals: Vec<Vec<f32>>,
        with_beats: bool,
        cancel: &CancelToken,
    ) -> Result<Heard> {
        let mut signals = signals.into_iter();
        let (slow, fast) = (signals.next(), signals.next());
        let rows = || {
            let conditioning = &self.conditioning;
            let slow = slow.as_deref().unwrap_or_default();
            conditioning.with(|extractor| extractor.extract_until(slow, cancel))
        };
        if !self.needs_beats(with_beats) {
            return Ok(Heard {
                rows: rows().map_err(of_features)?,
                beats: None,
            });
        }
        let fast = fast.unwrap_or_default();
        let beats = || {
            let beats = &self.beats;
            beats.with(|extractor| extractor.beats_until(fast, cancel))
        };
        // The longer of the two on this thread; the other's panic goes on here.
        let (rows, beats) = thread::scope(|scope| {
            let rows = scope.spawn(rows);
            let beats = beats();
            (rows.join(), beats)
        });
        let rows = rows.unwrap_or_else(|panicked| panic::resume_unwind(panicked));
        let (rows, beats) = (rows.map_err(of_features)?, beats.map_err(of_features)?);
        Ok(Heard {
            rows: with_counts_of(&beats, rows, &self.count_periods),
            beats: Some(beats),
        })
    }

    /// Whether beats are asked for, or the model counts them.
    fn needs_beats(&self, asked: bool) -> bool {
        asked || !self.count_periods.is_empty()
    }
}

fn of_features(error: FeatureError) -> Error {
    match error {
        FeatureError::Cancelled => EngineError::Cancelled.into(),
        other => other.into(),
    }
}

/// Feature extractors planned once and lent out, one per thread that needs one at a time.
#[derive(Debug)]
struct ExtractorPool {
    rate: Rate,
    profile: Profile,
    idle: Mutex<Vec<FeatureExtractor>>,
}

impl ExtractorPool {
    fn new(rate: Rate, profile: Profile) -> Self {
        Self {
            rate,
            profile,
            idle: Mutex::new(Vec::new()),
        }
    }

    /// Lends an extractor to `work`. One that saw a panic is not put back.
    fn with<T>(&self, work: impl FnOnce(&mut FeatureExtractor) -> T) -> T {
        let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let lent = idle().pop();
        let mut extractor = lent.unwrap_or_else(|| FeatureExtractor::new(self.rate, self.profile));
        let result = work(&mut extractor);
        idle().push(extractor);
        result
    }
}
