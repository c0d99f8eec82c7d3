//! An engine that does as it is told, so that limits and faults can be tested without a model.

use std::{
    collections::BTreeMap,
    panic::panic_any,
    sync::{
        Arc, Condvar, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::Duration,
};

use bailando::{
    CancelToken, Result,
    engine::{
        DEFAULT_BATCH, Ending, EngineError, GenerationOptions, Listener, Opening, Progress, Stage,
    },
    features::Profile,
    formats::{Codes, Continuation, GeneratedMotion, MusicInfo, PositionsSource, Timings},
    model::{
        DecoderSpec, FORMAT_VERSION, FeatureSpec, GptSpec, Manifest, SamplingDefaults,
        SuppressedCodes, Vocabulary, WeightStorage, WindowKind,
    },
    motion::{Animation, FinishOptions, Finisher, MotionFrame, Positions, Skeleton},
    server::Generate,
};
use bytes::Bytes;
use glam::{Quat, Vec3};
use ndarray::{Array2, Array3};
use tokio::sync::Semaphore;

use crate::client::LONG;

/// Audio that makes the fake wait until [`Fake::release`].
pub(crate) const BLOCK: &[u8] = b"block";
/// Audio that makes the fake panic.
pub(crate) const PANIC: &[u8] = b"panic";

/// Audio that makes the fake panic after the first frames of a stream.
pub(crate) const LATE_PANIC: &[u8] = b"late panic";

/// Dances 0.1 s to anything.
pub(crate) struct Fake {
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
        Arc::new(Self {
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

    /// Lets all that wait go on, now and later.
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

    fn block(&self, cancel: &CancelToken) -> Result<(), EngineError> {
        let mut open = self.open.lock().unwrap();
        while !*open {
            if cancel.is_cancelled() {
                self.saw_cancel.store(true, Ordering::SeqCst);
                return Err(EngineError::Cancelled);
            }
            open = self
                .opened
                .wait_timeout(open, Duration::from_millis(5))
                .unwrap()
                .0;
        }
        Ok(())
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

    fn generate(
        &self,
        audio: Bytes,
        options: &GenerationOptions,
        cancel: &CancelToken,
        progress: Arc<dyn Progress>,
    ) -> Result<GeneratedMotion> {
        let _end = CountEnd(&self.ended);
        self.generations.fetch_add(1, Ordering::SeqCst);
        progress.stage(Stage::Decoding);
        self.started.add_permits(1);
        if audio.starts_with(BLOCK) {
            self.block(cancel)?;
        }
        if audio.starts_with(PANIC) {
            panic_any("a panic that the test wants");
        }
        progress.decoded(0.1);
        progress.stage(Stage::Generating);
        progress.codes(1, 1);
        self.heard.lock().unwrap().push(audio);
        Ok(dance(options))
    }

    /// One code's frames, and after them whatever the audio says.
    fn stream(
        &self,
        audio: Bytes,
        options: &GenerationOptions,
        cancel: &CancelToken,
        listener: Arc<dyn Listener>,
    ) -> Result<Ending> {
        let _end = CountEnd(&self.ended);
        self.generations.fetch_add(1, Ordering::SeqCst);
        listener.stage(Stage::Decoding);
        if audio.starts_with(PANIC) {
            panic_any("a panic that the test wants");
        }
        listener.decoded(0.1);
        let dance = dance(options);
        let finish = FinishOptions {
            fps: options.fps,
            ..FinishOptions::default()
        };
        listener.opened(Opening {
            model: dance.model,
            seed: dance.seed,
            skeleton: dance.skeleton.clone(),
            fps: options.fps,
            frames: 8 * options.fps as usize / 60,
            positions_source: dance.positions_source,
            music: dance.music,
            timings: dance.timings,
            warnings: dance.warnings,
            finisher: Finisher::new(&dance.skeleton, &finish)?,
        });
        listener.stage(Stage::Generating);
        let joints = dance.skeleton.joints.len();
        listener.frames(Array2::from_shape_fn((8, 3 * joints), |(_, column)| {
            if column % 3 == 1 {
                0.1 * column as f32
            } else {
                0.0
            }
        }));
        self.started.add_permits(1);
        if audio.starts_with(BLOCK) {
            self.block(cancel)?;
        }
        if audio.starts_with(LATE_PANIC) {
            panic_any("a panic that the test wants");
        }
        self.heard.lock().unwrap().push(audio);
        Ok(Ending {
            tail: Some(Continuation::new(
                self.model_sha256(),
                dance.codes.clone(),
                [0.0; 2],
                0.0,
            )),
            codes: dance.codes,
            timings: dance.timings,
        })
    }

    fn pose(&self, upper: u32, lower: u32) -> Result<Positions> {
        self.check(&GenerationOptions {
            start_upper: Some(upper),
            start_lower: Some(lower),
            ..GenerationOptions::default()
        })?;
        Ok(dance(&GenerationOptions::default()).positions)
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
        },
        fps: 60,
        frames_per_code: 8,
        motion_frame: MotionFrame::World,
        vocabulary: Vocabulary {
            upper: 512,
            lower: 512,
        },
        gpt: GptSpec {
            block: 29,
            context: 28,
            channels: 8,
            layers: 2,
            heads: 2,
        },
        decoder: DecoderSpec {
            width: 8,
            receptive_codes: 4,
        },
        skeleton: skeleton(),
        upper_joints: vec![1, 2],
        lower_joints: vec![0],
        start_codes: vec![[1, 2]],
        suppressed_codes: SuppressedCodes {
            upper: Vec::new(),
            lower: vec![7],
        },
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

fn dance(options: &GenerationOptions) -> GeneratedMotion {
    const FRAMES: usize = 2;
    let skeleton = skeleton();
    let joints = skeleton.joints.len();
    let seed = options.seed.unwrap_or(7);
    let positions = Array3::from_shape_fn((FRAMES, joints, 3), |(frame, joint, axis)| match axis {
        1 => 1.0 + 0.25 * joint as f32,
        _ => 0.125 * frame as f32,
    });
    GeneratedMotion {
        model: "fake".into(),
        seed,
        animation: Animation {
            fps: options.fps,
            root: vec![Vec3::Y; FRAMES],
            rotations: vec![vec![Quat::IDENTITY; joints]; FRAMES],
        },
        skeleton,
        positions,
        positions_source: PositionsSource::Decoder,
        codes: Codes {
            upper: vec![u32::try_from(seed % 512).unwrap()],
            lower: vec![3],
        },
        music: options.music.then(|| MusicInfo {
            tempo_bpm: 120.0,
            beats_s: vec![0.0, 0.5],
        }),
        timings: Timings {
            queue: Duration::from_micros(100),
            decode: Duration::from_micros(200),
            features: Duration::from_micros(300),
            inference: Duration::from_micros(400),
            motion: Duration::from_micros(500),
        },
        warnings: vec!["a warning".into()],
        continuation: Some(Continuation::new(
            "0123",
            Codes {
                upper: vec![1],
                lower: vec![2],
            },
            [0.0; 2],
            0.0,
        )),
    }
}
