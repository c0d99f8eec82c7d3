//! From the bytes of a song to the conditioning of the model.

use std::{panic, thread};

use bytes::Bytes;
use ndarray::Array2;

use super::{
    EngineError, Progress, Stage,
    conditioning::Conditioning,
    effort::{DecodeEffort, Effort},
    form::Form,
    pool::Pool,
    progress::spent,
};
use crate::{
    CancelToken,
    audio::{self, AudioError, AudioLimits, AudioRange, DecodedAudio},
    features::{
        BeatFinder, BeatPhase, Beats, FeatureExtractor, Profile, Rate, SongBeats, with_counts,
    },
    formats::{MusicInfo, Timings},
    model::{BeatNetwork, CountSource, FeatureSpec},
};

const NO_BEATS: &str = "no beats were found in the audio: the dance follows none";
const NO_CLEAR_BEATS: &str = "no clear beats were found in the audio";

/// Audio decoder, feature extractors and trackers of beats for one model.
#[derive(Debug)]
pub(crate) struct AudioFrontend {
    limits: AudioLimits,
    effort: DecodeEffort,
    spec: FeatureSpec,
    extractors: Pool<FeatureExtractor>,
    /// Extractors of the beats that older models take their counts from.
    librosa: Pool<FeatureExtractor>,
    beatnet: Pool<(BeatFinder, BeatNetwork)>,
}

/// Which part of a song is wanted, and what of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Selection {
    pub(crate) range: AudioRange,
    /// Longest song in seconds, where that is less than the limit.
    pub(crate) longest: Option<f64>,
    /// Whether tempo and beats are wanted.
    pub(crate) music: bool,
    /// Whether beats are needed to choose between candidates.
    pub(crate) is_chosen: bool,
    /// Whether what returns in the song is to return in the dance.
    pub(crate) form: bool,
}

/// Which trackers of beats a request needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Trackers {
    librosa: bool,
    beatnet: bool,
}

/// What was found of a song.
struct Found {
    rows: Array2<f32>,
    librosa: Option<Beats>,
    beatnet: Option<SongBeats>,
}

impl AudioFrontend {
    pub(crate) fn new(spec: FeatureSpec, limits: AudioLimits, effort: DecodeEffort) -> Self {
        let profile = spec.profile;
        Self {
            limits,
            effort,
            extractors: Pool::new(move || Ok(FeatureExtractor::new(Rate::Conditioning, profile))),
            librosa: Pool::new(|| Ok(FeatureExtractor::new(Rate::Beats, Profile::Librosa011))),
            beatnet: Pool::new(|| Ok((BeatFinder::new(), BeatNetwork::open()?))),
            spec,
        }
    }

    /// The longest music in seconds that is danced to.
    pub(super) fn max_seconds(&self) -> f64 {
        self.limits.max_seconds
    }

    /// Loads the beat network, and runs it.
    ///
    /// # Errors
    /// [`EngineError::Model`].
    pub(crate) fn test(&self) -> Result<(), EngineError> {
        let silence = vec![0.0; BeatFinder::HZ as usize];
        self.song_beats(&silence, &CancelToken::new()).map(drop)
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
        let trackers = self.trackers(selection);
        progress.stage(Stage::Decoding);
        let audio = spent(&mut timings.decode, "decode", || {
            let rates = trackers.rates();
            self.decode(audio, selection, &rates, cancel)
        })?;
        let seconds = audio.duration_s;
        progress.decoded(seconds);
        progress.stage(Stage::Features);
        let mut conditioning = spent(&mut timings.features, "features", || {
            let found = self.find(audio.signals, trackers, cancel)?;
            self.conditioning(found, selection)
        })?;
        conditioning.warnings = audio.warnings;
        conditioning.seconds = Some(seconds);
        let is_told = conditioning.music.as_ref().is_none_or(|music| !music.beats_s.is_empty());
        let warning = match conditioning.beats.is_empty() {
            true if trackers.librosa || trackers.beatnet => Some(NO_BEATS),
            false if !is_told => Some(NO_CLEAR_BEATS),
            _ => None,
        };
        conditioning.warnings.extend(warning.map(str::to_owned));
        Ok(conditioning)
    }

    /// A model follows the counts, and is judged by the beats, that it was trained with; people
    /// are told the better ones. What a dance is like does not depend on what is told.
    fn trackers(&self, selection: Selection) -> Trackers {
        let counts = (!self.spec.count_periods.is_empty()).then_some(self.spec.counts);
        Trackers {
            librosa: counts == Some(CountSource::Librosa),
            beatnet: selection.music
                || counts == Some(CountSource::Beatnet)
                || counts.is_none() && (selection.is_chosen || selection.form),
        }
    }

    /// Decodes a song within the processor time for it.
    fn decode(
        &self,
        audio: Bytes,
        Selection { range, longest, .. }: Selection,
        rates: &[u32],
        cancel: &CancelToken,
    ) -> Result<DecodedAudio, EngineError> {
        let most = self.limits.max_seconds;
        let max_seconds = longest.map_or(most, |longest| longest.min(most));
        let limits = AudioLimits { max_seconds, ..self.limits.clone() };
        let limit = self.effort.of(audio.len(), range, max_seconds);
        let (effort, cancel) = Effort::begin(limit, cancel);
        audio::decode(audio, range, rates, &limits, &cancel).map_err(|error| match error {
            AudioError::Cancelled if effort.is_used_up() => {
                AudioError::DecodeTimeout { limit: effort.limit }.into()
            }
            other => other.into(),
        })
    }

    /// Features and beats, side by side; the signals are those of [`Trackers::rates`].
    fn find(
        &self,
        signals: Vec<Vec<f32>>,
        trackers: Trackers,
        cancel: &CancelToken,
    ) -> Result<Found, EngineError> {
        let mut signals = signals.into_iter();
        let slow = signals.next().unwrap_or_default();
        let mut next = |is_there: bool| is_there.then(|| signals.next().unwrap_or_default());
        let (fast, middle) = (next(trackers.librosa), next(trackers.beatnet));
        let extract =
            || self.extractors.with(|extractor| Ok(extractor.extract_until(&slow, cancel)?));
        let hear = || middle.as_ref().map(|pcm| self.song_beats(pcm, cancel)).transpose();
        let track = || {
            let track = |pcm| self.librosa.with(|tracker| Ok(tracker.beats_until(pcm, cancel)?));
            fast.map(track).transpose()
        };
        let (beatnet, (rows, librosa)) = side_by_side(hear, || side_by_side(extract, track));
        Ok(Found { rows: rows?, librosa: librosa?, beatnet: beatnet? })
    }

    fn song_beats(&self, pcm: &[f32], cancel: &CancelToken) -> Result<SongBeats, EngineError> {
        self.beatnet.with(|(finder, network)| network.beats(finder, pcm, cancel))
    }

    /// The rows with their counts, and the beats that go with them.
    fn conditioning(
        &self,
        found: Found,
        selection: Selection,
    ) -> Result<Conditioning, EngineError> {
        let Found { rows, librosa, beatnet } = found;
        let counts = match (&librosa, &beatnet) {
            (Some(beats), _) => BeatPhase::find(beats, rows.view()),
            (None, Some(song)) => BeatPhase::of(song, rows.view()),
            (None, None) => None,
        };
        let form = counts.as_ref().filter(|_| selection.form);
        let form = form.map(|counts| Form::of(rows.view(), counts)).unwrap_or_default();
        let FeatureSpec { counts_late_s, count_periods, .. } = &self.spec;
        let rows = with_counts(rows, counts.as_ref(), -counts_late_s, count_periods);
        // Rows of librosa's beats and motion frames have one rate, which manifests are checked for.
        let beats = match (librosa, &beatnet) {
            (Some(beats), _) => beats.frames,
            (None, Some(song)) => song.frames(Rate::Beats.rows_per_second()),
            (None, None) => Vec::new(),
        };
        let conditioning = Conditioning::new(rows, beats, self.spec.columns)?;
        let music = beatnet.filter(|_| selection.music).map(music_info);
        Ok(Conditioning { form, music, ..conditioning })
    }
}

impl Trackers {
    /// Sample rates of the signals: for the features, then for each tracker that is needed.
    fn rates(self) -> Vec<u32> {
        let librosa = self.librosa.then_some(Rate::Beats.hz());
        let beatnet = self.beatnet.then_some(BeatFinder::HZ);
        [Some(Rate::Conditioning.hz()), librosa, beatnet].into_iter().flatten().collect()
    }
}

fn music_info(song: SongBeats) -> MusicInfo {
    MusicInfo {
        tempo_bpm: song.tempo_bpm,
        tempo_steady: song.tempo_steady,
        beats_s: song.beats_s,
        downbeats_s: song.downbeats_s,
        metre: song.metre,
        confidence: song.confidence,
    }
}

/// Computes `beside` on a thread of its own and `here` on this one; both on this one where the
/// system has no more threads. A panic continues here.
fn side_by_side<A: Send, B>(beside: impl Fn() -> A + Sync, here: impl FnOnce() -> B) -> (A, B) {
    thread::scope(|scope| {
        let thread = thread::Builder::new().spawn_scoped(scope, &beside);
        let here = here();
        let beside = match thread {
            Ok(thread) => thread.join().unwrap_or_else(|panicked| panic::resume_unwind(panicked)),
            Err(_) => beside(),
        };
        (beside, here)
    })
}

#[cfg(test)]
mod tests {
    use super::{super::fake::directory, *};

    #[test]
    fn a_model_follows_the_counts_it_was_trained_with() {
        let (_folder, directory) = directory();
        let trackers = |counts, count_periods: &[u32], music, is_chosen, form| {
            let spec = directory.manifest().features.clone();
            let spec = FeatureSpec { counts, count_periods: count_periods.to_vec(), ..spec };
            let frontend =
                AudioFrontend::new(spec, AudioLimits::default(), DecodeEffort::default());
            let selection =
                Selection { range: AudioRange::default(), longest: None, music, is_chosen, form };
            let Trackers { librosa, beatnet } = frontend.trackers(selection);
            (librosa, beatnet)
        };
        use CountSource::{Beatnet, Librosa};
        assert_eq!(trackers(Librosa, &[], false, false, false), (false, false));
        assert_eq!(trackers(Librosa, &[], true, false, false), (false, true));
        assert_eq!(trackers(Librosa, &[], false, true, false), (false, true));
        assert_eq!(trackers(Librosa, &[], false, false, true), (false, true));
        // The same dance, whether or not beats are told.
        assert_eq!(trackers(Librosa, &[4], false, true, true), (true, false));
        assert_eq!(trackers(Librosa, &[4], true, true, false), (true, true));
        assert_eq!(trackers(Beatnet, &[4], false, false, true), (false, true));
        let rates = Trackers { librosa: true, beatnet: true }.rates();
        assert_eq!(rates, [3_840, 30_720, 22_050]);
    }

    #[test]
    fn counts_come_as_late_as_the_model_learned_them() {
        let (_folder, directory) = directory();
        let turn = |counts_late_s: f64| {
            let spec = directory.manifest().features.clone();
            let columns = crate::features::COLUMNS + 2;
            let spec = FeatureSpec { counts_late_s, count_periods: vec![1], columns, ..spec };
            let frontend =
                AudioFrontend::new(spec, AudioLimits::default(), DecodeEffort::default());
            // A beat, and a count, every 0.4 s.
            let frames = (0..60).map(|beat| 24 * beat).collect();
            let found = Found {
                rows: Array2::zeros((100, crate::features::COLUMNS)),
                librosa: Some(Beats { frames, ..Beats::default() }),
                beatnet: None,
            };
            let selection = Selection {
                range: AudioRange::default(),
                longest: None,
                music: false,
                is_chosen: false,
                form: false,
            };
            let rows = frontend.conditioning(found, selection).unwrap().features;
            let row = rows.row(30);
            f64::from(row[columns - 2].atan2(row[columns - 1])) / std::f64::consts::TAU
        };
        let later = (turn(0.0) - turn(0.05)).rem_euclid(1.0);
        assert!((later - 0.05 / 0.4).abs() < 1e-5, "{later}");
    }
}
