//! Audio in, motion out: the one path that the server and the command line share.

use std::{fmt, num::NonZeroUsize, path::PathBuf, sync::Arc, thread, time::Instant};

use crossbeam_channel::{Sender, TrySendError};
use ndarray::Array2;
use tokio::sync::oneshot;

use super::{
    EngineError, Generation, GenerationOptions, GenerationOutput, GenerationRequest, MusicSource,
    Observer, Pending,
    code_model::{CachedGpt, SharedDecoder},
    completion::Completion,
    conditioning::Conditioning,
    decoding::{self, DecodeTask, Prologue},
    effort::DecodeEffort,
    form::Form,
    frontend::AudioFrontend,
    given::{check_length, check_music},
    prepare::{AcceptedRequest, AudioRequest, Preparer},
    queue::Queue,
    sampler::draw_seed,
    scheduler::Scheduler,
    self_test,
    threads::{self, CloseOnDrop},
};
use crate::{
    audio::AudioLimits,
    codebook::Memory,
    model::{Device, Manifest, ModelDirectory, WindowKind},
    motion::Positions,
};

/// Sequences that share a step by default: with more, steps take longer in proportion.
pub const DEFAULT_BATCH: NonZeroUsize = NonZeroUsize::MIN.saturating_add(15);
/// Bytes of a GPT below which its steps have one thread: a small step is over before several
/// threads agree (`bailando bench`).
const SMALL_GPT: u64 = 8 << 20;

/// Checks `options` against a model of this SHA-256 whose steps have so many rows, for dances of at
/// most so many seconds.
///
/// # Errors
/// [`EngineError::Option`] names the first option that does not fit.
pub fn check_options(
    options: &GenerationOptions,
    manifest: &Manifest,
    model_sha256: &str,
    rows: usize,
    most_seconds: f64,
) -> Result<(), EngineError> {
    options.check(manifest, rows)?;
    check_length(options, manifest, most_seconds)?;
    match &options.continue_from {
        Some(tail) if !tail.is_of(model_sha256) => Err(EngineError::Option {
            name: "continue_from",
            problem: "it comes from a dance of another model".into(),
        }),
        _ => Ok(()),
    }
}

/// Settings of an [`Engine`].
#[derive(Clone, Debug)]
pub struct EngineConfig {
    /// The model directory.
    pub model_dir: PathBuf,
    /// What the model is computed on.
    pub device: Device,
    /// Threads that ONNX Runtime computes one step with.
    pub threads: usize,
    /// Sequences that share a step of the model, candidates counted. At most about three times as
    /// many generations have begun at once, those included that wait for rows or for their frames.
    pub batch: usize,
    /// Generations that may wait for each stage before they begin.
    pub queue: usize,
    /// Songs that are decoded at once: each has a thread, so that none waits for a longer one.
    pub songs: usize,
    /// What an upload may ask of the decoder.
    pub audio: AudioLimits,
    /// Processor time that decoding may take.
    pub effort: DecodeEffort,
    /// Receives the figures of the scheduler.
    pub observer: Arc<dyn Observer>,
}

impl EngineConfig {
    /// Settings for one caller at a time on all cores.
    #[must_use]
    pub fn new(model_dir: impl Into<PathBuf>) -> Self {
        Self {
            model_dir: model_dir.into(),
            device: Device::Cpu,
            threads: thread::available_parallelism().map_or(1, NonZeroUsize::get),
            batch: DEFAULT_BATCH.get(),
            queue: 1,
            songs: 2,
            audio: AudioLimits::default(),
            effort: DecodeEffort::default(),
            observer: Arc::new(()),
        }
    }
}

/// Handle to a loaded model and its threads; clones share them. They end with the last clone, once
/// what was submitted is done.
#[derive(Clone)]
pub struct Engine {
    shared: Arc<Shared>,
}

struct Shared {
    preparer: Arc<Preparer>,
    audio: CloseOnDrop<AudioRequest>,
    decoding: Sender<DecodeTask>,
    memory: Option<Memory>,
}

impl fmt::Debug for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Engine").field("model", &self.manifest().name).finish_non_exhaustive()
    }
}

impl Engine {
    /// Loads the model directory, tests it and starts its threads.
    ///
    /// # Errors
    /// [`EngineError::Model`] says which file of the directory is wrong and why;
    /// [`EngineError::NoThread`].
    pub fn open(config: &EngineConfig) -> Result<Self, EngineError> {
        let directory = Arc::new(ModelDirectory::open(&config.model_dir)?.on(config.device));
        let manifest = directory.manifest();
        GenerationOptions::default().check(manifest, config.batch)?;
        let threads = config.threads.max(1);
        let gpt = directory.gpt(step_threads(manifest, threads))?;
        let mut model = CachedGpt::new(gpt, config.batch);
        self_test::test_window(&mut model, manifest)?;
        let mut decoder = directory.decoder(threads)?;
        self_test::test_chunks(&mut decoder, manifest)?;

        let decoder = SharedDecoder::new(decoder);
        let decoding = decoding::start(decoder.clone(), config.batch)?;
        let scheduler = Scheduler::new(
            Box::new(model),
            decoder,
            Arc::clone(&directory),
            decoding.clone(),
            Arc::clone(&config.observer),
        );
        let scheduled = Arc::new(Queue::new(config.queue));
        threads::start_scheduler(scheduler, Arc::clone(&scheduled))?;
        let features = directory.manifest().features.clone();
        let frontend = AudioFrontend::new(features, config.audio.clone(), config.effort);
        frontend.test()?;
        let classifier = directory.style_classifier()?;
        let rows = config.batch;
        let decoder = decoding.clone();
        let preparer =
            Preparer { classifier, frontend, directory, rows, scheduled, decoding: decoder };
        let memory = memory(&preparer.directory);
        let (preparer, audio) = threads::start_frontends(preparer, config.songs, config.queue)?;
        let engine = Self { shared: Arc::new(Shared { preparer, audio, decoding, memory }) };
        engine.warm_up()?;
        Ok(engine)
    }

    /// Generates two codes by the path that requests take, with as many candidates as there is
    /// room for.
    fn warm_up(&self) -> Result<(), EngineError> {
        let options = GenerationOptions {
            seed: Some(0),
            temperature: Some(1.0),
            window: Some(WindowKind::Hop),
            hop: Some(1),
            ..GenerationOptions::default()
        };
        let conditioning = Conditioning {
            features: Array2::zeros((3, self.manifest().features.columns)),
            beats: vec![4, 12, 20],
            form: Form::default(),
            music: None,
            seconds: None,
            warnings: Vec::new(),
        };
        let (completion, generation) = Completion::new();
        let request = self.accept(options, &completion)?;
        self.shared.preparer.schedule_conditioned(conditioning, request)?;
        generation.wait().map(drop)
    }

    /// The loaded model's manifest.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        self.shared.preparer.directory.manifest()
    }

    /// SHA-256 of the loaded manifest, which identifies the whole model.
    #[must_use]
    pub fn model_sha256(&self) -> &str {
        self.shared.preparer.directory.manifest_sha256()
    }

    /// How often the model's training used each code; none where the model does not say.
    #[must_use]
    pub fn memory(&self) -> Option<&Memory> {
        self.shared.memory.as_ref()
    }

    /// Whether the scheduler still takes requests.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        !self.shared.preparer.scheduled.is_closed()
    }

    /// Checks `options` against the model without any work.
    ///
    /// # Errors
    /// [`EngineError::Option`] names the first option that does not fit.
    pub fn check(&self, options: &GenerationOptions) -> Result<(), EngineError> {
        let preparer = &self.shared.preparer;
        let (rows, most) = (preparer.rows, preparer.frontend.max_seconds());
        check_options(options, self.manifest(), self.model_sha256(), rows, most)
    }

    /// Submits a request. The returned future gives its output; dropping it cancels the request,
    /// which then stops within one packet, frame or step. Never blocks.
    ///
    /// # Errors
    /// The future gives any [`EngineError`]; [`EngineError::QueueFull`] at once.
    pub fn submit(&self, request: GenerationRequest) -> Generation {
        let (completion, generation) = Completion::new();
        if let Err(error) = self.try_submit(request, &completion) {
            completion.complete(Err(error));
        }
        generation
    }

    /// Submits a request and blocks the calling thread until its output is there.
    ///
    /// # Errors
    /// Any [`EngineError`].
    pub fn generate(&self, request: GenerationRequest) -> Result<GenerationOutput, EngineError> {
        self.submit(request).wait()
    }

    /// Shows what a pair of pose codes looks like: joints `[frames, joints, 3]`, metres, of the
    /// pair repeated (paper, Fig. 7).
    ///
    /// # Errors
    /// The future gives [`EngineError::Option`] for a code that is not in the vocabulary, or
    /// [`EngineError::QueueFull`].
    pub fn pose(&self, codes: [u32; 2]) -> Pending<Positions> {
        let options = GenerationOptions {
            start_upper: Some(codes[0]),
            start_lower: Some(codes[1]),
            ..GenerationOptions::default()
        };
        if let Err(error) = self.check(&options) {
            return Pending::ready(Err(error));
        }
        let (positions, receiver) = oneshot::channel();
        let task = DecodeTask::Pose {
            codes,
            directory: Arc::clone(&self.shared.preparer.directory),
            positions,
        };
        match self.shared.decoding.try_send(task) {
            Ok(()) => receiver.into(),
            Err(TrySendError::Disconnected(_)) => Pending::ready(Err(EngineError::Stopped)),
            Err(TrySendError::Full(_)) => Pending::ready(Err(EngineError::QueueFull {
                capacity: self.shared.decoding.capacity().unwrap_or(0),
            })),
        }
    }

    fn try_submit(
        &self,
        request: GenerationRequest,
        completion: &Arc<Completion>,
    ) -> Result<(), EngineError> {
        let GenerationRequest { music, options, progress, stream, longest, owner } = request;
        check_music(&music, &options)?;
        let accepted = self.accept(options, completion)?;
        let request = AcceptedRequest { progress, stream, longest, owner, ..accepted };
        let queue = &self.shared.audio.0;
        match music {
            MusicSource::Audio(audio) => queue.push(AudioRequest { audio: Some(audio), request }),
            MusicSource::None => queue.push(AudioRequest { audio: None, request }),
            MusicSource::Features(rows) => self.shared.preparer.schedule_features(rows, request),
        }
    }

    /// A request of checked options, without progress or stream.
    fn accept(
        &self,
        options: GenerationOptions,
        completion: &Arc<Completion>,
    ) -> Result<AcceptedRequest, EngineError> {
        self.check(&options)?;
        let seed = options.seed.map_or_else(draw_seed, Ok)?;
        let directory = Arc::clone(&self.shared.preparer.directory);
        Ok(AcceptedRequest {
            prologue: Prologue::new(directory, &options, seed),
            options,
            progress: Arc::new(()),
            stream: None,
            longest: None,
            owner: 0,
            completion: Arc::clone(completion),
            submitted: Instant::now(),
        })
    }
}

/// Dances do not depend on the memory: one that does not fit costs only itself.
fn memory(directory: &ModelDirectory) -> Option<Memory> {
    Memory::read(directory).unwrap_or_else(|error| {
        tracing::warn!(%error, "the model's memory is left out");
        None
    })
}

fn step_threads(manifest: &Manifest, threads: usize) -> usize {
    let file = manifest.files.get("gpt.onnx");
    match file.is_some_and(|file| file.bytes < SMALL_GPT) {
        true => 1,
        false => threads,
    }
}
