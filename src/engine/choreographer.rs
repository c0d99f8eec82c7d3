//! Audio in, dance out: the one path that the server and the command line share.

use std::{
    num::NonZeroUsize,
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use ndarray::{Array2, Axis, Slice, concatenate};

use super::{
    EngineError, GenerationOptions, Listener, Observer, Opening, Progress, Stage,
    ears::Ears,
    sampler::{Sampling, draw_seed},
    window::Window,
    worker::{Job, Outcome, Worker},
};
use crate::{
    CancelToken, Result,
    audio::AudioLimits,
    format::{Codes, Dance, MusicInfo, Tail, Timings},
    model::{Manifest, ModelDirectory},
    motion::{self, FinishOptions, Finisher, Positions, PositionsSource},
};

/// Dances that share a step where nobody says otherwise: beyond it steps take longer in proportion.
pub const DEFAULT_BATCH: NonZeroUsize = NonZeroUsize::MIN.saturating_add(15);
/// Most pose codes in a tail, so that it fits into the value of an option.
const LONGEST_TAIL: usize = 43;
/// Largest vocabulary whose codes a tail can hold.
const MOST_TAIL_CODES: usize = 1 << 16;
/// How often a pair is repeated to be looked at, and how many of these are shown: those in the middle, far
/// from the zero padding at the ends.
const REPEATS: (usize, usize) = (12, 4);

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
    /// Hears what the model's thread does.
    pub observer: Arc<dyn Observer>,
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
    ears: Ears,
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

/// What is known of a dance behind its last frame.
#[derive(Clone, Debug)]
pub struct Ending {
    /// The pose codes.
    pub codes: Codes,
    /// Where another dance can go on.
    pub tail: Option<Tail>,
    /// Wall time per stage.
    pub timings: Timings,
}

/// What the model hears, and what callers are told of it.
struct Song {
    rows: Array2<f32>,
    /// Frames of the beats; none where nobody needs them.
    beats: Vec<usize>,
    music: Option<MusicInfo>,
    warnings: Vec<String>,
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
            Arc::clone(&config.observer),
        )?;
        let features = &directory.manifest().features;
        let ears = Ears::new(
            features.profile,
            features.count_periods.clone(),
            config.audio.clone(),
        );
        Ok(Self {
            shared: Arc::new(Shared {
                directory,
                worker,
                batch: config.batch,
                ears,
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
        options.check(self.manifest(), self.shared.batch)?;
        match &options.continue_from {
            Some(tail) if !tail.is_of(self.model_sha256()) => Err(EngineError::Option {
                name: "continue_from",
                problem: "it comes from a dance of another model".into(),
            }),
            _ => Ok(()),
        }
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
        let mut timings = Timings::default();
        let song = self.hear(audio, options, cancel, progress.as_ref(), &mut timings)?;
        let seed = options.seed.map_or_else(draw_seed, Ok)?;
        progress.stage(Stage::Generating);
        let job = self.job(song.rows, song.beats, seed, options, cancel, progress);
        let outcome = self.dance(job, &mut timings)?;
        let finished = spent(&mut timings.motion, "motion", || {
            let options = self.finish_options(options);
            let skeleton = &self.manifest().skeleton;
            let goes_on = || !cancel.is_cancelled();
            motion::finish_while(outcome.motion.view(), skeleton, &options, goes_on)
        })?
        .ok_or(EngineError::Cancelled)?;
        let tail = self.tail(&outcome, options);
        Ok(Dance {
            model: self.manifest().name.clone(),
            seed,
            skeleton: self.manifest().skeleton.clone(),
            animation: finished.animation,
            positions: finished.positions,
            positions_source: finished.source,
            codes: outcome.codes,
            music: song.music,
            timings,
            warnings: song.warnings,
            tail,
        })
    }

    /// Generates one dance and gives its motion to `listener` as it is decoded. Blocks as
    /// [`Choreographer::generate`] does.
    ///
    /// # Errors
    /// As [`Choreographer::generate`]; before the listener's opening, where the song or an option is at
    /// fault.
    pub fn stream(
        &self,
        audio: Bytes,
        options: &GenerationOptions,
        cancel: &CancelToken,
        listener: Arc<dyn Listener>,
    ) -> Result<Ending> {
        let mut timings = Timings::default();
        let song = self.hear(audio, options, cancel, listener.as_ref(), &mut timings)?;
        let seed = options.seed.map_or_else(draw_seed, Ok)?;
        let finish = self.finish_options(options);
        let manifest = self.manifest();
        let decoded = (song.rows.nrows() * manifest.frames_per_code) as u64;
        let frames = (decoded * u64::from(finish.fps)).div_ceil(u64::from(finish.decoded_fps));
        listener.opened(Opening {
            model: manifest.name.clone(),
            seed,
            skeleton: manifest.skeleton.clone(),
            fps: finish.fps,
            frames: frames as usize,
            positions_source: match finish.fps == finish.decoded_fps {
                true => PositionsSource::Decoder,
                false => PositionsSource::ForwardKinematics,
            },
            music: song.music,
            timings,
            warnings: song.warnings,
            finisher: Finisher::new(&manifest.skeleton, &finish)?,
        });
        listener.stage(Stage::Generating);
        let progress = Arc::clone(&listener) as Arc<dyn Progress>;
        let job = self.job(song.rows, song.beats, seed, options, cancel, progress);
        let job = Job {
            listener: Some(listener),
            ..job
        };
        let outcome = self.dance(job, &mut timings)?;
        Ok(Ending {
            tail: self.tail(&outcome, options),
            codes: outcome.codes,
            timings,
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
        self.check(options)?;
        let seed = options.seed.map_or_else(draw_seed, Ok)?;
        progress.stage(Stage::Generating);
        let mut timings = Timings::default();
        let job = self.job(rows, Vec::new(), seed, options, cancel, progress);
        let outcome = self.dance(job, &mut timings)?;
        Ok(RawDance {
            seed,
            codes: outcome.codes,
            motion: outcome.motion,
            queued: timings.queue,
            inference: timings.inference,
        })
    }

    /// What a pair of pose codes looks like: joints `[frames, joints, 3]`, metres, of the pair repeated, in
    /// the middle of that (paper, Fig. 7). Blocks.
    ///
    /// # Errors
    /// [`EngineError::Option`] for a code that is not in the vocabulary, [`EngineError::QueueFull`].
    pub fn pose(&self, upper: u32, lower: u32) -> Result<Positions> {
        let manifest = self.manifest();
        GenerationOptions {
            start_upper: Some(upper),
            start_lower: Some(lower),
            ..GenerationOptions::default()
        }
        .check(manifest, self.shared.batch)?;
        let (repeats, shown) = REPEATS;
        let codes = Codes {
            upper: vec![upper; repeats],
            lower: vec![lower; repeats],
        };
        let motion = self.shared.worker.decode(codes)?;
        let first = (repeats - shown) / 2 * manifest.frames_per_code;
        let middle = Slice::from(first..first + shown * manifest.frames_per_code);
        let finish = self.finish_options(&GenerationOptions {
            root_motion: false,
            ..GenerationOptions::default()
        });
        let middle = motion.slice_axis(Axis(0), middle);
        Ok(motion::finish(middle, &manifest.skeleton, &finish)?.positions)
    }

    /// The song as the model hears it.
    fn hear(
        &self,
        audio: Bytes,
        options: &GenerationOptions,
        cancel: &CancelToken,
        progress: &dyn Progress,
        timings: &mut Timings,
    ) -> Result<Song> {
        self.check(options)?;
        let candidates = options.candidates(self.manifest(), self.shared.batch);
        let with_beats = options.music || candidates > 1;
        let ears = &self.shared.ears;
        progress.stage(Stage::Decoding);
        let audio = spent(&mut timings.decode, "decode", || {
            ears.decode(audio, options.range, with_beats, cancel)
        })?;
        progress.decoded(audio.duration_s);
        progress.stage(Stage::Features);
        let heard = spent(&mut timings.features, "features", || {
            ears.listen(audio.signals, with_beats, cancel)
        })?;
        let fps = f64::from(self.manifest().fps);
        let beats = heard.beats.as_ref();
        Ok(Song {
            rows: heard.rows,
            beats: beats
                .into_iter()
                .flat_map(|beats| beats.seconds())
                .map(|second| (second * fps).round() as usize)
                .collect(),
            music: beats.filter(|_| options.music).map(|beats| MusicInfo {
                tempo_bpm: beats.tempo_bpm,
                beats_s: beats.seconds().collect(),
            }),
            warnings: audio.warnings,
        })
    }

    fn job(
        &self,
        rows: Array2<f32>,
        beats: Vec<usize>,
        seed: u64,
        options: &GenerationOptions,
        cancel: &CancelToken,
        progress: Arc<dyn Progress>,
    ) -> Job {
        let manifest = self.manifest();
        let defaults = manifest.sampling;
        let tail = options.continue_from.as_ref();
        Job {
            music: rows,
            sampling: Sampling {
                temperature: options.temperature.unwrap_or(defaults.temperature),
                top_k: options.top_k.or(defaults.top_k),
            },
            guidance: options.guidance.unwrap_or(defaults.guidance),
            candidates: options.candidates(manifest, self.shared.batch),
            beats,
            seed,
            start: [options.start_upper, options.start_lower],
            window: Window::new(
                options.window.unwrap_or(defaults.window),
                options.hop.unwrap_or(defaults.hop),
                manifest.gpt.context,
            ),
            history: tail.map_or_else(Codes::default, |tail| tail.codes.clone()),
            facing: tail.map_or(0.0, |tail| tail.facing),
            progress,
            listener: None,
            cancel: cancel.clone(),
        }
    }

    fn dance(&self, mut job: Job, timings: &mut Timings) -> Result<Outcome> {
        check_rows(&job.music, self.manifest().features.columns)?;
        if let Some(leads) = job.lead_in() {
            // The code that leads in stands before the first row, which nobody hears (ARCHITECTURE 3).
            let first = job.music.slice_axis(Axis(0), Slice::from(..leads));
            // Both have the same columns.
            if let Ok(music) = concatenate(Axis(0), &[first, job.music.view()]) {
                job.music = music;
            }
            for beat in &mut job.beats {
                *beat += leads * self.manifest().frames_per_code;
            }
        }
        let span = tracing::info_span!("inference").entered();
        let outcome = self.shared.worker.run(job)?;
        drop(span);
        timings.queue = outcome.queued;
        timings.inference = outcome.inference;
        Ok(outcome)
    }

    fn finish_options(&self, options: &GenerationOptions) -> FinishOptions {
        FinishOptions {
            fps: options.fps,
            root_motion: options.root_motion,
            decoded_fps: self.manifest().fps,
            start: start_of(options),
        }
    }

    /// The end of a dance, and of the one that it goes on from where it is short itself.
    fn tail(&self, outcome: &Outcome, options: &GenerationOptions) -> Option<Tail> {
        let vocabulary = self.manifest().vocabulary;
        if vocabulary.upper.max(vocabulary.lower) > MOST_TAIL_CODES {
            return None;
        }
        let count = (self.manifest().decoder.receptive_codes + 1).min(LONGEST_TAIL);
        let before = options.continue_from.as_ref().map(|tail| &tail.codes);
        let half = |of: fn(&Codes) -> &Vec<u32>| -> Vec<u32> {
            let before = before.map_or(&[][..], |codes| of(codes));
            let all = before.iter().chain(of(&outcome.codes));
            let length = before.len() + of(&outcome.codes).len();
            all.skip(length.saturating_sub(count)).copied().collect()
        };
        let codes = Codes {
            upper: half(|codes| &codes.upper),
            lower: half(|codes| &codes.lower),
        };
        let [x, z] = start_of(options);
        let [walked_x, walked_z] = outcome.walked;
        let place = [x + walked_x, z + walked_z];
        let facing = outcome.facing;
        Some(Tail::new(self.model_sha256(), codes, place, facing))
    }
}

/// Where the root starts on the floor.
fn start_of(options: &GenerationOptions) -> [f32; 2] {
    let tail = options.continue_from.as_ref();
    tail.map_or([0.0; 2], |tail| tail.place)
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

/// Measures a stage, in a span of its name.
fn spent<T>(elapsed: &mut Duration, stage: &'static str, work: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let result = tracing::info_span!("stage", otel.name = stage).in_scope(work);
    *elapsed = started.elapsed();
    result
}
