//! The thread that owns the ONNX sessions, behind a bounded channel.

use std::{
    panic::{self, AssertUnwindSafe},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use ndarray::Array2;

use super::{
    EngineError,
    generator::{Request, decode_codes, generate_codes},
    progress::{Progress, Stage},
    sampler::{Sampler, Sampling},
    window::Window,
};
use crate::{
    CancelToken, Error, Result,
    format::Codes,
    model::{Decoder, Gpt, Manifest, ModelDirectory, ModelError, WindowKind},
};

/// One request's work for the model.
pub(crate) struct Job {
    /// Music rows `[rows, columns]`.
    pub(crate) music: Array2<f32>,
    /// How the next code is chosen.
    pub(crate) sampling: Sampling,
    /// Seed of the request's generator.
    pub(crate) seed: u64,
    /// Given start codes, upper and lower.
    pub(crate) start: [Option<u32>; 2],
    /// How the window of past codes moves.
    pub(crate) window: Window,
    /// Hears about every code.
    pub(crate) progress: Arc<dyn Progress>,
    /// Checked at every step.
    pub(crate) cancel: CancelToken,
}

/// What the model made of a [`Job`].
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) codes: Codes,
    /// Decoder output `[frames, columns]`.
    pub(crate) motion: Array2<f32>,
    /// From submission to the first step.
    pub(crate) queued: Duration,
    /// From the first step to the last frame.
    pub(crate) inference: Duration,
}

struct Ticket {
    job: Job,
    submitted: Instant,
    reply: Sender<Result<Outcome>>,
}

/// Handle to the model thread; clones share it. The thread ends when the last handle is dropped.
#[derive(Clone, Debug)]
pub(crate) struct Worker {
    queue: Sender<Ticket>,
    capacity: usize,
}

impl Worker {
    /// Loads the sessions on a thread of their own and returns once they are ready.
    pub(crate) fn start(
        directory: ModelDirectory,
        threads: usize,
        capacity: usize,
    ) -> Result<Self> {
        let capacity = capacity.max(1);
        let (queue, tickets) = bounded::<Ticket>(capacity);
        let (ready, loaded) = bounded(1);
        thread::Builder::new()
            .name("model".into())
            .spawn(move || match Sessions::load(&directory, threads) {
                Ok(mut sessions) => {
                    // A full or gone receiver only means that nobody waits any more.
                    let _ = ready.send(Ok(()));
                    drop(ready);
                    serve(&mut sessions, &tickets);
                }
                Err(error) => {
                    let _ = ready.send(Err(error));
                }
            })
            .map_err(|_| EngineError::Stopped)?;
        loaded.recv().map_err(|_| EngineError::Stopped)??;
        Ok(Self { queue, capacity })
    }

    /// Queues `job` and waits for its outcome; blocks the calling thread.
    pub(crate) fn run(&self, job: Job) -> Result<Outcome> {
        let (reply, outcome) = bounded(1);
        let ticket = Ticket {
            job,
            submitted: Instant::now(),
            reply,
        };
        self.queue.try_send(ticket).map_err(|error| match error {
            TrySendError::Full(_) => EngineError::QueueFull {
                capacity: self.capacity,
            },
            TrySendError::Disconnected(_) => EngineError::Stopped,
        })?;
        outcome.recv().map_err(|_| EngineError::Stopped)?
    }
}

fn serve(sessions: &mut Sessions, tickets: &Receiver<Ticket>) {
    for Ticket {
        job,
        submitted,
        reply,
    } in tickets
    {
        let queued = submitted.elapsed();
        // A panic costs this request only: the sessions hold no state between jobs.
        let result = panic::catch_unwind(AssertUnwindSafe(|| sessions.run(&job, queued)))
            .unwrap_or_else(|_| Err(EngineError::Panicked.into()));
        // The receiver may have gone; its request is over then.
        let _ = reply.send(result);
    }
}

struct Sessions {
    gpt: Gpt,
    decoder: Decoder,
    directory: ModelDirectory,
}

impl Sessions {
    fn load(directory: &ModelDirectory, threads: usize) -> Result<Self> {
        let mut sessions = Self {
            gpt: directory.gpt(threads)?,
            decoder: directory.decoder(threads)?,
            directory: directory.clone(),
        };
        sessions.warm_up()?;
        Ok(sessions)
    }

    /// Two steps and their frames: a graph that cannot run is found at start, not by a user.
    fn warm_up(&mut self) -> Result<()> {
        let columns = self.directory.manifest().features.columns;
        let job = Job {
            music: Array2::zeros((3, columns)),
            sampling: Sampling {
                temperature: 0.0,
                top_k: None,
            },
            seed: 0,
            start: [Some(0), Some(0)],
            window: Window::new(WindowKind::Sliding, 1, 2),
            progress: Arc::new(()),
            cancel: CancelToken::new(),
        };
        self.run(&job, Duration::ZERO).map(drop)
    }

    fn run(&mut self, job: &Job, queued: Duration) -> Result<Outcome> {
        let started = Instant::now();
        let manifest = self.directory.manifest();
        let mut sampler = Sampler::new(job.sampling, job.seed);
        let start = start_codes(job.start, manifest, &mut sampler);
        let request = Request {
            music: job.music.view(),
            start,
            window: job.window,
            progress: job.progress.as_ref(),
            cancel: &job.cancel,
        };
        let codes = generate_codes(&mut self.gpt, &mut sampler, &request).map_err(cancelled)?;
        job.progress.stage(Stage::Motion);
        let motion = decode_codes(
            &mut self.decoder,
            &codes,
            manifest.decoder.receptive_codes,
            manifest.frames_per_code,
            &job.cancel,
        )
        .map_err(cancelled)?;
        Ok(Outcome {
            codes,
            motion,
            queued,
            inference: started.elapsed(),
        })
    }
}

/// The start pair: given codes win; the rest is drawn as a pair from the manifest's list, or from
/// the whole vocabulary when it has none. Both numbers are drawn always, so that giving one half
/// does not change the dance's other draws.
fn start_codes(given: [Option<u32>; 2], manifest: &Manifest, sampler: &mut Sampler) -> [u32; 2] {
    let vocabulary = manifest.vocabulary;
    let drawn = match manifest.start_codes.as_slice() {
        [] => [
            sampler.uniform(vocabulary.upper) as u32,
            sampler.uniform(vocabulary.lower) as u32,
        ],
        pairs => pairs
            .get(sampler.uniform(pairs.len()))
            .copied()
            .unwrap_or_default(),
    };
    [given[0].unwrap_or(drawn[0]), given[1].unwrap_or(drawn[1])]
}

fn cancelled(error: ModelError) -> Error {
    match error {
        ModelError::Cancelled => EngineError::Cancelled.into(),
        other => other.into(),
    }
}
