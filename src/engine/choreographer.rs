//! Audio in, dance out: the one path that the server and the command line share.

use std::{
    num::NonZeroUsize,
    panic,
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use bytes::Bytes;
use ndarray::Array2;

use super::{
    EngineError, GenerationOptions, Progress, Stage,
    sampler::{Sampling, draw_seed},
    window::Window,
    worker::{Job, Outcome, Worker},
};
use crate::{
    CancelToken, Error, Result,
    audio::{self, AudioError, AudioLimits},
    features::{FeatureExtractor, Profile, Rate, with_counts_of},
    format::{Codes, Dance, MusicInfo, Timings},
    model::{Manifest, ModelDirectory},
    motion::{self, FinishOptions},
};

/// Dances that share a step where nobody says otherwise: beyond it steps take longer in proportion.
pub const DEFAULT_BATCH: NonZeroUsize = NonZeroUsize::MIN.saturating_add(15);

/// What a [`Choreographer`] needs to start.
#[derive(Clone, Debug)]
pub struct EngineConfig {
    /// The model directory.
    pub model_dir: PathBuf,
    /// Threads that ONNX Runtime computes one step with.
    pub threads: usize,
    /// Dances that share a step of the model, candidates counted; twice as many generations are begun at
    /// once at most.
    pub batch: usize,
    /// Generations that may wait for the model before they begin.
    pub queue: usize,
    /// What an upload may ask of the decoder.
    pub audio: AudioLimits,
}

/// Handle to a loaded model; clones share it.
#[derive(Clone, Debug)]
pub struct Choreographer {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    directory: ModelDirectory,
    worker: Worker,
    batch: usize,
    limits: AudioLimits,
    conditioning: ExtractorPool,
    beats: ExtractorPool,
}

/// Codes and motion from given feature rows, before anything is made of the motion.
#[derive(Clone, Debug)]
pub struct RawDance {
    /// The seed that was used.
    pub seed: u64,
    /// The pose codes.
    pub codes: Codes,
    /// Decoded motion `[frames, 3 joints]` in world directions: root velocity in columns 0..2,
    /// root-relative joints.
    pub motion: Array2<f32>,
    /// Waiting for the model.
    pub queued: Duration,
    /// Codes and decoded motion.
    pub inference: Duration,
}

impl Choreographer {
    /// Loads the model directory and starts its thread.
    ///
    /// # Errors
    /// [`crate::model::ModelError`] says which file of the directory is wrong and why.
    pub fn open(config: &EngineConfig) -> Result<Self> {
        let directory = ModelDirectory::open(&config.model_dir)?;
        GenerationOptions::default().check(directory.manifest(), config.batch)?;
        let worker = Worker::start(
            directory.clone(),
            config.threads.max(1),
            config.batch,
            config.queue,
        )?;
        let profile = directory.manifest().features.profile;
        Ok(Self {
            shared: Arc::new(Shared {
                directory,
                worker,
                batch: config.batch,
                limits: config.audio.clone(),
                conditioning: ExtractorPool::new(Rate::Conditioning, profile),
                // Beats for people are those of the current profile, whatever the model hears.
                beats: ExtractorPool::new(Rate::Beats, Profile::Librosa011),
            }),
        })
    }

    /// The loaded model's manifest.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        self.shared.directory.manifest()
    }

    /// SHA-256 of the loaded manifest, which identifies the whole model.
    #[must_use]
    pub fn model_sha256(&self) -> &str {
        self.shared.directory.manifest_sha256()
    }

    /// Whether the model's thread still takes work.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        self.shared.worker.is_alive()
    }

    /// Checks `options` against the model without any work.
    ///
    /// # Errors
    /// [`EngineError::Option`] names the first option that does not fit.
    pub fn check(&self, options: &GenerationOptions) -> Result<(), EngineError> {
        options.check(self.manifest(), self.shared.batch)
    }

    /// Generates one dance. Blocks: decoding and features run on the calling thread, the model on
    /// its own.
    ///
    /// # Errors
    /// Any [`crate::Error`]; [`EngineError::Cancelled`] soon after `cancel` is triggered.
    pub fn generate(
        &self,
        audio: Bytes,
        options: &GenerationOptions,
        cancel: &CancelToken,
    ) -> Result<Dance> {
        self.generate_with_progress(audio, options, cancel, Arc::new(()))
    }

    /// [`Choreographer::generate`] that reports how far it has come.
    ///
    /// # Errors
    /// The same.
    pub fn generate_with_progress(
        &self,
        audio: Bytes,
        options: &GenerationOptions,
        cancel: &CancelToken,
        progress: Arc<dyn Progress>,
    ) -> Result<Dance> {
        self.check(options)?;
        let mut timings = Timings::default();
        progress.stage(Stage::Decoding);
        let heard = timed(&mut timings.decode, || self.hear(audio, options, cancel))?;
        progress.stage(Stage::Features);
        let listened = timed(&mut timings.features, || {
            self.listen(&heard, options, cancel)
        })?;
        let raw = self.dance(listened.rows, listened.beats_s, options, cancel, progress)?;
        timings.queue = raw.queued;
        timings.inference = raw.inference;
        let finish = FinishOptions {
            fps: options.fps,
            root_motion: options.root_motion,
            decoded_fps: self.manifest().fps,
        };
        let skeleton = &self.manifest().skeleton;
        let finished = timed(&mut timings.motion, || {
            motion::finish(raw.motion.view(), skeleton, &finish)
        })?;
        Ok(Dance {
            model: self.manifest().name.clone(),
            seed: raw.seed,
            skeleton: skeleton.clone(),
            animation: finished.animation,
            positions: finished.positions,
            positions_source: finished.source,
            codes: raw.codes,
            music: listened.music,
            timings,
            warnings: heard.warnings,
        })
    }

    /// Generates codes and raw motion from feature rows `[rows, columns]` as the manifest's
    /// features say (438 columns, and those of its count periods); blocks. Rows tell no beats to the
    /// frame: there is one candidate for every phrase.
    ///
    /// # Errors
    /// [`EngineError::Option`] for rows of another width or too few, else as
    /// [`Choreographer::generate`].
    pub fn dance_to_rows(
        &self,
        rows: Array2<f32>,
        options: &GenerationOptions,
        cancel: &CancelToken,
        progress: Arc<dyn Progress>,
    ) -> Result<RawDance> {
        self.dance(rows, Vec::new(), options, cancel, progress)
    }

    /// Codes and motion for rows, and beats in seconds where they are known.
    fn dance(
        &self,
        rows: Array2<f32>,
        beats_s: Vec<f64>,
        options: &GenerationOptions,
        cancel: &CancelToken,
        progress: Arc<dyn Progress>,
    ) -> Result<RawDance> {
        self.check(options)?;
        let manifest = self.manifest();
        check_rows(&rows, manifest.features.columns)?;
        let defaults = manifest.sampling;
        let seed = options.seed.map_or_else(draw_seed, Ok)?;
        progress.stage(Stage::Generating);
        let job = Job {
            music: rows,
            sampling: Sampling {
                temperature: options.temperature.unwrap_or(defaults.temperature),
                top_k: options.top_k.or(defaults.top_k),
            },
            guidance: options.guidance.unwrap_or(defaults.guidance),
            candidates: options.candidates.unwrap_or(defaults.candidates),
            beats: beats_s
                .iter()
                .map(|second| (second * f64::from(manifest.fps)).round() as usize)
                .collect(),
            seed,
            start: [options.start_upper, options.start_lower],
            window: Window::new(
                options.window.unwrap_or(defaults.window),
                options.hop.unwrap_or(defaults.hop),
                manifest.gpt.context,
            ),
            progress,
            cancel: cancel.clone(),
        };
        let Outcome {
            codes,
            motion,
            queued,
            inference,
        } = self.shared.worker.run(job)?;
        Ok(RawDance {
            seed,
            codes,
            motion,
            queued,
            inference,
        })
    }

    fn hear(
        &self,
        audio: Bytes,
        options: &GenerationOptions,
        cancel: &CancelToken,
    ) -> Result<audio::DecodedAudio> {
        let both = [Rate::Conditioning.hz(), Rate::Beats.hz()];
        let rates = if self.wants_beats(options) {
            &both[..]
        } else {
            &both[..1]
        };
        audio::decode(audio, options.range, rates, &self.shared.limits, cancel).map_err(|error| {
            match error {
                AudioError::Cancelled => EngineError::Cancelled.into(),
                other => Error::from(other),
            }
        })
    }

    fn listen(
        &self,
        heard: &audio::DecodedAudio,
        options: &GenerationOptions,
        cancel: &CancelToken,
    ) -> Result<Listened> {
        let signal = |index: usize| heard.signals.get(index).map_or(&[][..], Vec::as_slice);
        check_cancelled(cancel)?;
        let rows = || {
            let conditioning = &self.shared.conditioning;
            conditioning.with(|extractor| extractor.extract(signal(0)))
        };
        if !self.wants_beats(options) {
            return Ok(Listened {
                rows: rows()?,
                beats_s: Vec::new(),
                music: None,
            });
        }
        let beats = || {
            let beats = &self.shared.beats;
            beats.with(|extractor| extractor.beats(signal(1)))
        };
        // The longer of the two on this thread; the other's panic goes on here.
        let (rows, beats) = thread::scope(|scope| {
            let rows = scope.spawn(rows);
            let beats = beats();
            (rows.join(), beats)
        });
        let rows = rows.unwrap_or_else(|panicked| panic::resume_unwind(panicked))?;
        let beats = beats?;
        check_cancelled(cancel)?;
        let periods = &self.manifest().features.count_periods;
        let beats_s: Vec<f64> = beats.seconds().collect();
        Ok(Listened {
            rows: with_counts_of(&beats, rows, periods),
            music: options.music.then(|| MusicInfo {
                tempo_bpm: beats.tempo_bpm,
                beats_s: beats_s.clone(),
            }),
            beats_s,
        })
    }

    /// Whether the caller asks for beats, the model counts them, or candidates are chosen by them.
    fn wants_beats(&self, options: &GenerationOptions) -> bool {
        let manifest = self.manifest();
        options.music
            || !manifest.features.count_periods.is_empty()
            || options.candidates.unwrap_or(manifest.sampling.candidates) > 1
    }
}

struct Listened {
    rows: Array2<f32>,
    beats_s: Vec<f64>,
    music: Option<MusicInfo>,
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

fn check_cancelled(cancel: &CancelToken) -> Result<(), EngineError> {
    if cancel.is_cancelled() {
        Err(EngineError::Cancelled)
    } else {
        Ok(())
    }
}

fn check_rows(rows: &Array2<f32>, columns: usize) -> Result<(), EngineError> {
    let problem = if rows.ncols() != columns || rows.nrows() < 2 {
        format!(
            "expected at least 2 rows of {columns} columns, got {:?}",
            rows.dim()
        )
    } else if rows.iter().any(|value| !value.is_finite()) {
        "a value is not a finite number".into()
    } else {
        return Ok(());
    };
    Err(EngineError::Option {
        name: "features",
        problem,
    })
}

fn timed<T>(elapsed: &mut Duration, work: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let result = work();
    *elapsed = started.elapsed();
    result
}
