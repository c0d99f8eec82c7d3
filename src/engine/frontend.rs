//! From the bytes of a song to the conditioning of the model.

use std::{panic, thread};

use bytes::Bytes;
use parking_lot::Mutex;

use super::{
    EngineError, Progress, Stage,
    conditioning::Conditioning,
    effort::{DecodeEffort, Effort},
    progress::spent,
};
use crate::{
    CancelToken,
    audio::{self, AudioError, AudioLimits, AudioRange, DecodedAudio},
    features::{FeatureError, FeatureExtractor, Profile, Rate, with_counts_of},
    formats::Timings,
    model::FeatureSpec,
};

/// Audio decoder and feature extractors for one model.
#[derive(Debug)]
pub(crate) struct AudioFrontend {
    limits: AudioLimits,
    effort: DecodeEffort,
    spec: FeatureSpec,
    conditioning: ExtractorPool,
    beats: ExtractorPool,
}

/// Which part of a song is wanted, and what of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Selection {
    pub(crate) range: AudioRange,
    /// Whether beats are wanted, for the caller or to choose between candidates.
    pub(crate) beats: bool,
}

impl AudioFrontend {
    pub(crate) fn new(spec: FeatureSpec, limits: AudioLimits, effort: DecodeEffort) -> Self {
        Self {
            limits,
            effort,
            conditioning: ExtractorPool::new(Rate::Conditioning, spec.profile),
            // Beats for people are those of the current profile, whatever the model's is.
            beats: ExtractorPool::new(Rate::Beats, Profile::Librosa011),
            spec,
        }
    }

    /// Decodes a song and computes its features.
    ///
    /// # Errors
    /// [`EngineError::Audio`], [`EngineError::Features`], or [`EngineError::Cancelled`] soon after
    /// `cancel` is triggered.
    pub(crate) fn condition(
        &self,
        audio: Bytes,
        selection: Selection,
        cancel: &CancelToken,
        progress: &dyn Progress,
        timings: &mut Timings,
    ) -> Result<Conditioning, EngineError> {
        // The model may be conditioned on counts, which are found between beats.
        let with_beats = selection.beats || !self.spec.count_periods.is_empty();
        progress.stage(Stage::Decoding);
        let audio = spent(&mut timings.decode, "decode", || {
            let rates = [Rate::Conditioning.hz(), Rate::Beats.hz()];
            let rates = &rates[..1 + usize::from(with_beats)];
            self.decode(audio, selection.range, rates, cancel)
        })?;
        let seconds = audio.duration_s;
        progress.decoded(seconds);
        progress.stage(Stage::Features);
        let conditioning =
            spent(&mut timings.features, "features", || self.features(audio.signals, cancel))?;
        let mut warnings = audio.warnings;
        if with_beats && conditioning.beats.is_empty() {
            warnings.push("no beats were found in the audio: the dance follows none".to_owned());
        }
        Ok(Conditioning { warnings, seconds: Some(seconds), ..conditioning })
    }

    /// Decodes a song within the processor time for it.
    fn decode(
        &self,
        audio: Bytes,
        range: AudioRange,
        rates: &[u32],
        cancel: &CancelToken,
    ) -> Result<DecodedAudio, EngineError> {
        let limit = self.effort.of(audio.len(), range, self.limits.max_seconds);
        let (effort, cancel) = Effort::begin(limit, cancel);
        audio::decode(audio, range, rates, &self.limits, &cancel).map_err(|error| match error {
            AudioError::Cancelled if effort.is_used_up() => {
                AudioError::DecodeTimeout { limit: effort.limit }.into()
            }
            other => other.into(),
        })
    }

    /// Features, and beats where there is a second signal for them.
    fn features(
        &self,
        signals: Vec<Vec<f32>>,
        cancel: &CancelToken,
    ) -> Result<Conditioning, EngineError> {
        let mut signals = signals.into_iter();
        let slow = signals.next().unwrap_or_default();
        let extract = || self.conditioning.with(|extractor| extractor.extract_until(&slow, cancel));
        let Some(fast) = signals.next() else {
            return Conditioning::new(extract()?, None, self.spec.columns);
        };
        let track = || self.beats.with(|extractor| extractor.beats_until(fast, cancel));
        let (rows, beats) = side_by_side(extract, track);
        let (rows, beats) = (rows?, beats?);
        let rows = with_counts_of(&beats, rows, &self.spec.count_periods);
        Conditioning::new(rows, Some(beats), self.spec.columns)
    }
}

/// Computes `shorter` on a thread of its own and `longer` on this one; both on this one where the
/// system has no more threads. A panic continues here.
fn side_by_side<A: Send, B>(
    shorter: impl Fn() -> Result<A, FeatureError> + Sync,
    longer: impl FnOnce() -> Result<B, FeatureError>,
) -> (Result<A, FeatureError>, Result<B, FeatureError>) {
    thread::scope(|scope| {
        let beside = thread::Builder::new().spawn_scoped(scope, &shorter);
        let longer = longer();
        let shorter = match beside {
            Ok(beside) => beside.join().unwrap_or_else(|panicked| panic::resume_unwind(panicked)),
            Err(_) => shorter(),
        };
        (shorter, longer)
    })
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
        Self { rate, profile, idle: Mutex::new(Vec::new()) }
    }

    /// Lends an extractor to `work`. One that saw a panic is not put back.
    fn with<T>(&self, work: impl FnOnce(&mut FeatureExtractor) -> T) -> T {
        let lent = self.idle.lock().pop();
        let mut extractor = lent.unwrap_or_else(|| FeatureExtractor::new(self.rate, self.profile));
        let result = work(&mut extractor);
        self.idle.lock().push(extractor);
        result
    }
}
