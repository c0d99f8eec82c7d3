//! The thread that makes frames of codes, beside the one that chooses them: a chunk of frames takes as long as dozens of
//! steps.

use std::{
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, Sender, bounded};
use ndarray::{Array2, Axis};
use parking_lot::{Mutex, MutexGuard};

use super::{
    EngineError,
    chunk_decoder::ChunkDecoder,
    chunks::Chunk,
    observer::{Observer, guarded},
    progress::Stage,
    reply::Reply,
    worker::{Job, Outcome},
};
use crate::{
    Result,
    formats::Codes,
    model::{Decoder, Manifest, ModelError},
    motion::ToWorld,
};

/// The decoder, which one thread at a time has. The lock is a fair one: who judges a phrase waits for the chunk in the making, not
/// for all that wait behind it.
#[derive(Clone)]
pub(crate) struct SharedDecoder(Arc<Mutex<Decoder>>);

impl SharedDecoder {
    pub(crate) fn new(decoder: Decoder) -> Self {
        Self(Arc::new(Mutex::new(decoder)))
    }

    /// Waits for it. A panic leaves nothing half done in it: it remembers nothing from run to run.
    pub(crate) fn lock(&self) -> MutexGuard<'_, Decoder> {
        self.0.lock()
    }
}

/// The frames of one dance, as far as there are any.
pub(crate) struct Footage {
    job: Arc<Job>,
    chunks: ChunkDecoder,
    /// Decoded motion that nobody has heard.
    motion: Array2<f32>,
}

impl Footage {
    /// Nothing yet.
    pub(crate) fn new(job: Arc<Job>, manifest: &Manifest) -> Self {
        let to_world = ToWorld::new(manifest.motion_frame, f64::from(job.facing));
        Self {
            chunks: ChunkDecoder::new(job.history.clone(), to_world),
            motion: Array2::zeros((0, 3 * manifest.skeleton.joints.len())),
            job,
        }
    }

    fn add(&mut self, chunk: &Chunk, decoder: &SharedDecoder) -> Result<()> {
        let cancel = &self.job.cancel;
        // The decoder is free again before anybody hears of the frames.
        let motion = self.chunks.decode(chunk, &mut decoder.lock(), cancel)?;
        match &self.job.listener {
            Some(listener) => listener.frames(motion),
            None => self
                .motion
                .append(Axis(0), motion.view())
                .map_err(|_| columns_differ(&motion, self.motion.ncols()))?,
        }
        Ok(())
    }

    fn end(&mut self, end: End) -> Outcome {
        self.job.progress.stage(Stage::Motion);
        let (walked, facing) = self.chunks.end();
        Outcome {
            codes: end.codes,
            motion: std::mem::take(&mut self.motion),
            walked,
            facing: facing as f32,
            queued: end.queued,
            inference: end.started.elapsed(),
        }
    }
}

/// The next chunk of a dance.
pub(crate) struct Take {
    pub(crate) footage: Arc<Mutex<Footage>>,
    pub(crate) chunk: Chunk,
    /// With the last one.
    pub(crate) end: Option<End>,
    pub(crate) reply: Arc<Reply>,
}

/// What else an outcome consists of.
pub(crate) struct End {
    pub(crate) codes: Codes,
    pub(crate) queued: Duration,
    /// When the first step was taken.
    pub(crate) started: Instant,
}

impl Take {
    /// Answers if it was the last.
    fn make(self, decoder: &SharedDecoder, observer: &dyn Observer) {
        // One that failed, or was cancelled, is of no use any more.
        if self.reply.is_given() {
            return;
        }
        let made = guarded(observer, || {
            let mut footage = self.footage.lock();
            footage.add(&self.chunk, decoder)?;
            Ok(self.end.map(|end| footage.end(end)))
        });
        match made {
            Ok(None) => {}
            Ok(Some(outcome)) => self.reply.give(Ok(outcome)),
            Err(error) => self.reply.give(Err(error)),
        }
    }
}

/// Handle to the thread, which makes what it was given still and ends when the handle is dropped.
pub(crate) struct Frames {
    takes: Sender<Take>,
}

impl Frames {
    /// At most `waiting` chunks wait.
    ///
    /// # Errors
    /// [`EngineError::Stopped`] when there are no threads left.
    pub(crate) fn start(
        decoder: SharedDecoder,
        waiting: usize,
        observer: Arc<dyn Observer>,
    ) -> Result<Self, EngineError> {
        let (takes, given) = bounded(waiting);
        thread::Builder::new()
            .name("frames".into())
            .spawn(move || serve(&given, &decoder, &*observer))
            .map_err(|_| EngineError::Stopped)?;
        Ok(Self { takes })
    }

    /// Gives the thread a chunk; waits while too many wait already.
    ///
    /// # Errors
    /// [`EngineError::Stopped`] when the thread has ended, which only a defect of ours can do to it.
    pub(crate) fn make(&self, take: Take) -> Result<(), EngineError> {
        self.takes.send(take).map_err(|_| EngineError::Stopped)
    }
}

fn serve(given: &Receiver<Take>, decoder: &SharedDecoder, observer: &dyn Observer) {
    for take in given {
        take.make(decoder, observer);
    }
}

fn columns_differ(motion: &Array2<f32>, expected: usize) -> ModelError {
    ModelError::Input {
        what: "decoder.onnx: columns in world directions",
        expected: expected.to_string(),
        got: motion.ncols().to_string(),
    }
}
