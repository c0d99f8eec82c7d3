//! An engine that does as it is told, so that limits and faults can be tested without a model.

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind, panic_any},
    sync::{
        Arc, Condvar, Mutex, Weak,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::Duration,
};

use bailando::{
    audio::AudioError,
    engine::{
        DEFAULT_BATCH, EngineError, Generation, GenerationOptions, GenerationOutput,
        GenerationRequest, MotionOutput, MusicSource, Opening, Pending, Stage,
    },
    features::Profile,
    formats::{Codes, Continuation, MusicInfo, PositionsSource, Timings},
    model::{
        CountSource, DecoderSpec, FORMAT_VERSION, FeatureSpec, GptSpec, Manifest, SamplingDefaults,
        SuppressedCodes, Vocabulary, WeightStorage, WindowKind,
    },
    motion::{Animation, FinishOptions, Finished, Finisher, MotionFrame, Positions, Skeleton},
    server::Generate,
};
use bytes::Bytes;
use glam::{Quat, Vec3};
use ndarray::{Array2, Array3};
use tokio::sync::{Semaphore, oneshot};

use crate::server::client::LONG;

/// Audio that makes the fake wait until [`Fake::release`].
pub(crate) const BLOCK: &[u8] = b"block";
/// Audio that makes the fake panic.
pub(crate) const PANIC: &[u8] = b"panic";

/// Audio that makes the fake panic after the first frames of a stream.
pub(crate) const LATE_PANIC: &[u8] = b"late panic";

/// Audio that makes the fake generate many frames.
pub(crate) const LONG_DANCE: &[u8] = b"long dance";
/// A song of 100 s, which waits as [`BLOCK`] does.
pub(crate) const LONG_SONG: &[u8] = b"long song";

/// Generates 0.1 s of motion to anything else.
pub(crate) struct Fake {
    /// Itself, for its threads.
    this: Weak<Self>,
    manifest: Manifest,
    open: Mutex<bool>,
    opened: Condvar,
    /// One permit per generation that has started.
    pub(crate) started: Semaphore,
    /// One permit per generation that has ended.
    pub(crate) ended: Semaphore,
    pub(crate) generations: AtomicUsize,
    pub(crate) saw_cancel: AtomicBool,
    pub(crate) stopped: AtomicBool,
    pub(crate) heard: Mutex<Vec<Bytes>>,
}

impl Fake {
    pub(crate) fn new() -> Arc<Self> {
        Arc::new_cyclic(|this| Self {
            this: Weak::clone(this),
            manifest: manifest(),
            open: Mutex::new(false),
            opened: Condvar::new(),
            started: Semaphore::new(0),
            ended: Semaphore::new(0),
            generations: AtomicUsize::new(0),
            saw_cancel: AtomicBool::new(false),
            stopped: AtomicBool::new(false),
            heard: Mutex::new(Vec::new()),
        })
    }

    /// Lets all that wait continue, now and later.
    pub(crate) fn release(&self) {
        *self.open.lock().unwrap() = true;
        self.opened.notify_all();
    }

    /// Waits until `count` more generations have started.
    pub(crate) async fn wait_started(&self, count: u32) {
        take(&self.started, count).await;
    }

    /// Waits until `count` more generations have ended.
    pub(crate) async fn wait_ended(&self, count: u32) {
        take(&self.ended, count).await;
    }

    fn block(&self, is_cancelled: impl Fn() -> bool) -> Result<(), EngineError> {
        let mut open = self.open.lock().unwrap();
        while !*open {
            if is_cancelled() {
                self.saw_cancel.store(true, Ordering::SeqCst);
                return Err(EngineError::Cancelled);
            }
            open = self.opened.wait_timeout(open, Duration::from_millis(5)).unwrap().0;
        }
        Ok(())
    }

    fn generate(
        &self,
        request: &GenerationRequest,
        is_cancelled: impl Fn() -> bool,
    ) -> Result<GenerationOutput, EngineError> {
        let _end = CountEnd(&self.ended);
        let audio = match &request.music {
            MusicSource::Audio(audio) => audio.clone(),
            MusicSource::None => Bytes::new(),
            MusicSource::Features(_) => panic_any("the server asks for dances to audio"),
        };
        self.generations.fetch_add(1, Ordering::SeqCst);
        let progress = &request.progress;
        progress.stage(Stage::Decoding);
        if let (Some(max_seconds), true) = (request.longest, audio.starts_with(LONG_SONG)) {
            return Err(AudioError::TooLong { seconds: 100.0, max_seconds }.into());
        }
        let frames = if audio.starts_with(LONG_DANCE) { MANY_FRAMES } else { FRAMES };
        let mut output = output(&request.options, frames);
        match &request.stream {
            None => self.started.add_permits(1),
            Some(_) if audio.starts_with(PANIC) => panic_any("a panic that the test wants"),
            Some(stream) => {
                progress.decoded(0.1);
                stream.opened(opening(&request.options)?);
                progress.stage(Stage::Generating);
                stream.frames(decoded());
                output.motion = MotionOutput::Streamed;
                self.started.add_permits(1);
            }
        }
        if audio.starts_with(BLOCK) || audio.starts_with(LONG_SONG) {
            self.block(is_cancelled)?;
        }
        if audio.starts_with(PANIC) || audio.starts_with(LATE_PANIC) {
            panic_any("a panic that the test wants");
        }
        if request.stream.is_none() {
            progress.decoded(0.1);
            progress.stage(Stage::Generating);
            progress.codes(1, 1);
        }
        self.heard.lock().unwrap().push(audio);
        Ok(output)
    }
}

async fn take(semaphore: &Semaphore, count: u32) {
    let taken = tokio::time::timeout(LONG, semaphore.acquire_many(count)).await;
    taken.expect("generations start and end").unwrap().forget();
}

struct CountEnd<'fake>(&'fake Semaphore);

impl Drop for CountEnd<'_> {
    fn drop(&mut self) {
        self.0.add_permits(1);
    }
}

impl Generate for Fake {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    fn model_sha256(&self) -> &str {
        "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef"
    }

    fn is_alive(&self) -> bool {
        !self.stopped.load(Ordering::SeqCst)
    }

    fn check(&self, options: &GenerationOptions) -> Result<(), EngineError> {
        options.check(&self.manifest, DEFAULT_BATCH.get())
    }

    /// Works on a thread of its own, as the engine does.
    fn submit(&self, request: GenerationRequest) -> Generation {
        let (sender, receiver) = oneshot::channel();
        let fake = self.this.upgrade().unwrap();
        std::thread::spawn(move || {
            let work = || fake.generate(&request, || sender.is_closed());
            let result = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
                let message = "a panic that the test wants".to_owned();
                Err(EngineError::Panicked { message })
            });
            // What the work holds is given back first.
            drop((request, fake));
            let _ = sender.send(result);
        });
        Generation::from(receiver)
    }

    fn pose(&self, codes: [u32; 2]) -> Pending<Positions> {
        let (sender, receiver) = oneshot::channel();
        let checked = self.check(&GenerationOptions {
            start_upper: Some(codes[0]),
            start_lower: Some(codes[1]),
            ..GenerationOptions::default()
        });
        let _ = sender.send(checked.map(|()| positions(FRAMES)));
        Pending::from(receiver)
    }
}

fn skeleton() -> Skeleton {
    Skeleton {
        joints: ["pelvis", "spine", "head"].map(str::to_owned).to_vec(),
        parents: vec![-1, 0, 1],
        offsets: vec![[0.0, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.5, 0.0]],
        root_height: 1.0,
    }
}

fn manifest() -> Manifest {
    Manifest {
        format_version: FORMAT_VERSION,
        name: "fake".into(),
        licence: "MIT".into(),
        features: FeatureSpec {
            profile: Profile::Librosa011,
            sample_rate: 3_840,
            hop: 512,
            columns: 438,
            count_periods: Vec::new(),
            counts: CountSource::default(),
            counts_late_s: 0.0,
        },
        styles: Vec::new(),
        energy: false,
        fps: 60,
        frames_per_code: 8,
        motion_frame: MotionFrame::World,
        vocabulary: Vocabulary { upper: 512, lower: 512 },
        gpt: GptSpec { block: 29, context: 28, channels: 8, layers: 2, heads: 2 },
        decoder: DecoderSpec { width: 8, receptive_codes: 4 },
        skeleton: skeleton(),
        upper_joints: vec![1, 2],
        lower_joints: vec![0],
        start_codes: vec![[1, 2]],
        style_start_codes: BTreeMap::new(),
        style_codes: BTreeMap::new(),
        suppressed_codes: SuppressedCodes { upper: Vec::new(), lower: vec![7] },
        sampling: SamplingDefaults {
            temperature: 1.0,
            top_k: None,
            guidance: 1.0,
            candidates: 1,
            redo: false,
            window: WindowKind::Hop,
            hop: 15,
        },
        weights: WeightStorage::F32,
        files: BTreeMap::new(),
        training: BTreeMap::new(),
    }
}

const FRAMES: usize = 2;
/// JSON of about four megabytes: more than the buffers of a connection hold.
const MANY_FRAMES: usize = 60_000;

fn positions(frames: usize) -> Positions {
    let joints = skeleton().joints.len();
    Array3::from_shape_fn((frames, joints, 3), |(frame, joint, axis)| match axis {
        1 => 1.0 + 0.25 * joint as f32,
        _ => 0.125 * frame as f32,
    })
}

/// One code's frames of decoded motion.
fn decoded() -> Array2<f32> {
    let columns = 3 * skeleton().joints.len();
    Array2::from_shape_fn((8, columns), |(_, column)| match column % 3 {
        1 => 0.1 * column as f32,
        _ => 0.0,
    })
}

fn opening(options: &GenerationOptions) -> Result<Opening, EngineError> {
    let output = output(options, FRAMES);
    let finish = FinishOptions { fps: options.fps, ..FinishOptions::default() };
    Ok(Opening {
        model: "fake".into(),
        seed: output.seed,
        skeleton: skeleton(),
        fps: options.fps,
        frames: 8 * options.fps as usize / 60,
        positions_source: PositionsSource::Decoder,
        style: output.style,
        music: output.music,
        timings: output.timings,
        warnings: output.warnings,
        finisher: Finisher::new(&skeleton(), &finish)?,
    })
}

fn output(options: &GenerationOptions, frames: usize) -> GenerationOutput {
    let joints = skeleton().joints.len();
    let seed = options.seed.unwrap_or(7);
    let codes = Codes { upper: vec![u32::try_from(seed % 512).unwrap()], lower: vec![3] };
    let before = Codes { upper: vec![1], lower: vec![2] };
    GenerationOutput {
        seed,
        motion: MotionOutput::Finished(Finished {
            animation: Animation {
                fps: options.fps,
                root: vec![Vec3::Y; frames],
                rotations: vec![vec![Quat::IDENTITY; joints]; frames],
            },
            positions: positions(frames),
            source: PositionsSource::Decoder,
        }),
        tail: Some(Continuation::new("0123", before, [0.0; 2], 0.0)),
        codes,
        style: None,
        music: options.music.then(|| MusicInfo {
            tempo_bpm: 120.0,
            tempo_steady: true,
            beats_s: vec![0.0, 0.5],
            downbeats_s: vec![0.0],
            metre: 4,
            confidence: 0.9,
        }),
        timings: Timings {
            queue: Duration::from_micros(100),
            decode: Duration::from_micros(200),
            features: Duration::from_micros(300),
            inference: Duration::from_micros(400),
            motion: Duration::from_micros(500),
        },
        warnings: vec!["a warning".into()],
        song_start_s: options.range.offset_s,
    }
}
