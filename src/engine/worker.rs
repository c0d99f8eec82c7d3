//! The thread that owns the ONNX sessions and all dances in the making, behind a bounded queue.

use std::{
    fmt,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use crossbeam_channel::bounded;
use ndarray::Array2;

use super::{
    EngineError,
    batch::{Batch, Reply},
    progress::Progress,
    queue::{Queue, Refused},
    sampler::Sampling,
    sessions::Sessions,
    window::Window,
};
use crate::{CancelToken, Result, format::Codes, model::ModelDirectory};

/// One request's work for the model.
pub(crate) struct Job {
    /// Music rows `[rows, columns]`.
    pub(crate) music: Array2<f32>,
    /// How the next code is chosen.
    pub(crate) sampling: Sampling,
    /// How strongly the music's time is followed.
    pub(crate) guidance: f32,
    /// Candidates for every phrase.
    pub(crate) candidates: usize,
    /// Frames of the music's beats, which candidates are chosen by; may be empty.
    pub(crate) beats: Vec<usize>,
    /// Seed of the request's generator.
    pub(crate) seed: u64,
    /// Given start codes, upper and lower.
    pub(crate) start: [Option<u32>; 2],
    /// How the window of past codes moves.
    pub(crate) window: Window,
    /// Hears how many codes there are.
    pub(crate) progress: Arc<dyn Progress>,
    /// Checked at every step.
    pub(crate) cancel: CancelToken,
}

impl Job {
    /// Whether candidates differ, and there are beats to choose between them by.
    pub(crate) fn has_a_choice(&self) -> bool {
        let differ = self.sampling.temperature > 0.0 && self.sampling.top_k != Some(1);
        self.candidates > 1 && differ && !self.beats.is_empty()
    }

    /// Dances that are computed side by side for it.
    pub(crate) fn rows(&self) -> usize {
        let candidates = if self.has_a_choice() {
            self.candidates
        } else {
            1
        };
        candidates * branches(self.guidance)
    }
}

/// With and without the music's time, where a dance is guided by it.
pub(crate) fn branches(guidance: f32) -> usize {
    1 + usize::from(guidance != 1.0)
}

/// What the model made of a [`Job`].
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) codes: Codes,
    /// Decoded motion in world directions, `[frames, 3 joints]`.
    pub(crate) motion: Array2<f32>,
    /// From submission to the first step.
    pub(crate) queued: Duration,
    /// From the first step to the last frame.
    pub(crate) inference: Duration,
}

struct Ticket {
    job: Job,
    submitted: Instant,
    reply: Reply,
}

impl fmt::Debug for Ticket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Ticket").finish_non_exhaustive()
    }
}

/// Handle to the model thread, which ends when the handle is dropped.
#[derive(Debug)]
pub(crate) struct Worker {
    queue: Arc<Queue<Ticket>>,
}

impl Worker {
    /// Loads the sessions on a thread of their own and returns once they are ready. At most `rows`
    /// dances share a step, and `capacity` requests wait before they begin.
    pub(crate) fn start(
        directory: ModelDirectory,
        threads: usize,
        rows: usize,
        capacity: usize,
    ) -> Result<Self> {
        let queue = Arc::new(Queue::new(capacity));
        let guard = AbandonOnDrop(Arc::clone(&queue));
        let (ready, loaded) = bounded(1);
        thread::Builder::new()
            .name("model".into())
            .spawn(move || {
                // Whatever ends this thread, nobody waits for it any longer.
                let guard = guard;
                match Sessions::load(directory, threads).and_then(|sessions| sessions.tried(rows)) {
                    Ok(mut batch) => {
                        // A receiver that has gone only means that nobody waits any more.
                        let _ = ready.send(Ok(()));
                        serve(&mut batch, &guard.0);
                    }
                    Err(error) => {
                        let _ = ready.send(Err(error));
                    }
                }
            })
            .map_err(|_| EngineError::Stopped)?;
        loaded.recv().map_err(|_| EngineError::Stopped)??;
        Ok(Self { queue })
    }

    /// Queues `job` and waits for its outcome; blocks the calling thread, at most until `job` is
    /// cancelled.
    pub(crate) fn run(&self, job: Job) -> Result<Outcome> {
        let cancel = job.cancel.clone();
        let (reply, outcome) = bounded(1);
        // The first to speak is heard: the model's thread, or the cancellation.
        let _guard = cancel.interruptible({
            let reply = reply.clone();
            move || {
                let _ = reply.try_send(Err(EngineError::Cancelled.into()));
            }
        });
        let ticket = Ticket {
            job,
            submitted: Instant::now(),
            reply: Reply(reply),
        };
        let number = self.queue.push(ticket).map_err(|refused| match refused {
            Refused::Full => EngineError::QueueFull {
                capacity: self.queue.capacity(),
            },
            Refused::Closed => EngineError::Stopped,
        })?;
        let result = outcome.recv().map_err(|_| EngineError::Stopped)?;
        // One that was cancelled while it waited gives its place back.
        self.queue.remove(number);
        result
    }

    /// Whether the model's thread still takes work.
    pub(crate) fn is_alive(&self) -> bool {
        !self.queue.is_closed()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.queue.close();
    }
}

struct AbandonOnDrop(Arc<Queue<Ticket>>);

impl Drop for AbandonOnDrop {
    fn drop(&mut self) {
        self.0.abandon();
    }
}

/// Takes requests in whenever they may begin, until the queue is closed and nothing is left to do.
fn serve(batch: &mut Batch, queue: &Queue<Ticket>) {
    loop {
        while batch.has_place() {
            let ticket = match batch.is_idle() {
                true => queue.pop(),
                false => queue.try_pop(),
            };
            match ticket {
                Some(Ticket {
                    job,
                    submitted,
                    reply,
                }) => batch.join(job, reply, submitted.elapsed()),
                None if batch.is_idle() => return,
                None => break,
            }
        }
        batch.round();
    }
}
