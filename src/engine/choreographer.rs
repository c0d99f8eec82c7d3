//! Audio in, dance out: the one path that the server and the command line share.

use std::{num::NonZeroUsize, path::PathBuf, sync::Arc, time::Duration};

use bytes::Bytes;
use ndarray::{Array2, Axis, Slice};

use super::{
    EngineError, GenerationOptions, Listener, Observer, Opening, Progress, Stage,
    ears::Ears,
    progress::spent,
    sampler::{Sampling, draw_seed},
    song::{Listening, Music, Song},
    tail::{start_of, tail_of},
    window::Window,
    worker::{Job, Outcome, Worker},
};
use crate::{
    CancelToken, Result,
    audio::AudioLimits,
    formats::{Codes, Continuation, GeneratedMotion, Timings},
    model::{Manifest, ModelDirectory},
    motion::{self, FinishOptions, Finisher, Positions, PositionsSource},
};

/// Dances that share a step where nobody says otherwise: beyond it steps take longer in proportion.
pub const DEFAULT_BATCH: NonZeroUsize = NonZeroUsize::MIN.saturating_add(15);
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
    /// Dances that share a step of the model, candidates counted; about three times as many generations are in
    /// the making at once at most, those counted that wait for rows or for their frames.
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
    pub tail: Option<Continuation>,
    /// Wall time per stage.
    pub timings: Timings,
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
    ) -> Result<GeneratedMotion> {
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
    ) -> Result<GeneratedMotion> {
        let mut timings = Timings::default();
        let song = self.hear(audio, options, cancel, progress.as_ref(), &mut timings)?;
        let seed = options.seed.map_or_else(draw_seed, Ok)?;
        progress.stage(Stage::Generating);
        let job = self.job(song.music, seed, options, cancel, progress);
        let outcome = self.dance(job, &mut timings)?;
        let finished = spent(&mut timings.motion, "motion", || {
            let options = self.finish_options(options);
            let skeleton = &self.manifest().skeleton;
            let goes_on = || !cancel.is_cancelled();
            motion::finish_while(outcome.motion.view(), skeleton, &options, goes_on)
        })?
        .ok_or(EngineError::Cancelled)?;
        let continuation = tail_of(&outcome, options, &self.shared.directory);
        Ok(GeneratedMotion {
            model: self.manifest().name.clone(),
            seed,
            skeleton: self.manifest().skeleton.clone(),
            animation: finished.animation,
            positions: finished.positions,
            positions_source: finished.source,
            codes: outcome.codes,
            music: song.info,
            timings,
            warnings: song.warnings,
            continuation,
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
        let decoded = (song.music.rows.nrows() * manifest.frames_per_code) as u64;
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
            music: song.info,
            timings,
            warnings: song.warnings,
            finisher: Finisher::new(&manifest.skeleton, &finish)?,
        });
        listener.stage(Stage::Generating);
        let progress = Arc::clone(&listener) as Arc<dyn Progress>;
        let job = self.job(song.music, seed, options, cancel, progress);
        let job = Job {
            listener: Some(listener),
            ..job
        };
        let outcome = self.dance(job, &mut timings)?;
        Ok(Ending {
            tail: tail_of(&outcome, options, &self.shared.directory),
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
        let music = Music::new(rows, Vec::new(), self.manifest().features.columns)?;
        let seed = options.seed.map_or_else(draw_seed, Ok)?;
        progress.stage(Stage::Generating);
        let mut timings = Timings::default();
        let job = self.job(music, seed, options, cancel, progress);
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
        let manifest = self.manifest();
        let listening = Listening {
            ears: &self.shared.ears,
            manifest,
            options,
            has_a_choice: options.candidates(manifest, self.shared.batch) > 1,
        };
        listening.song(audio, cancel, progress, timings)
    }

    fn job(
        &self,
        music: Music,
        seed: u64,
        options: &GenerationOptions,
        cancel: &CancelToken,
        progress: Arc<dyn Progress>,
    ) -> Job {
        let manifest = self.manifest();
        let defaults = manifest.sampling;
        let tail = options.continue_from.as_ref();
        let music = match tail {
            Some(_) => music.led_in(manifest.frames_per_code),
            None => music,
        };
        Job {
            music: music.rows,
            sampling: Sampling {
                temperature: options.temperature.unwrap_or(defaults.temperature),
                top_k: options.top_k.or(defaults.top_k),
            },
            guidance: options.guidance.unwrap_or(defaults.guidance),
            candidates: options.candidates(manifest, self.shared.batch),
            redo: options.redo(manifest, self.shared.batch),
            beats: music.beats,
            seed,
            start: [options.start_upper, options.start_lower],
            window: Window::new(
                options.window.unwrap_or(defaults.window),
                options.hop.unwrap_or(defaults.hop),
                manifest.gpt.context,
            ),
            history: tail.map_or_else(Codes::default, |tail| tail.codes.clone()),
            facing: tail.map_or(0.0, |tail| tail.heading),
            progress,
            listener: None,
            cancel: cancel.clone(),
        }
    }

    fn dance(&self, job: Job, timings: &mut Timings) -> Result<Outcome> {
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
}
