//! The thread that owns the motion GPT and all dances in the making, behind a bounded queue.

use std::{
    fmt,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use crossbeam_channel::{Sender, bounded};
use ndarray::Array2;

use super::{
    EngineError,
    batch::Batch,
    observer::Observer,
    progress::{Listener, Progress},
    queue::{Queue, Refused},
    reply::Reply,
    sampler::Sampling,
    sessions::Sessions,
    window::Window,
};
use crate::{CancelToken, Result, formats::Codes, model::ModelDirectory};

/// Codes that lead into a dance that goes on from another.
pub(crate) const LEAD_IN: usize = 1;

/// One request's work for the model.
pub(crate) struct Job {
    /// Music rows `[rows, columns]`.
    pub(crate) music: Array2<f32>,
    /// How the next code is chosen.
    pub(crate) sampling: Sampling,
    /// How strongly the music's time is followed.
    pub(crate) guidance: f32,
    /// Candidates for every phrase; 1 where they would not differ.
    pub(crate) candidates: usize,
    /// Whether a phrase is danced anew where it stands still.
    pub(crate) redo: bool,
    /// Frames of the music's beats, which candidates are chosen by; may be empty.
    pub(crate) beats: Vec<usize>,
    /// Seed of the request's generator.
    pub(crate) seed: u64,
    /// Given start codes, upper and lower.
    pub(crate) start: [Option<u32>; 2],
    /// How the window of past codes moves.
    pub(crate) window: Window,
    /// Codes that the dance goes on from; none where it starts anew. The last of them leads in: it stands
    /// before the first row of music, and is no part of the dance.
    pub(crate) history: Codes,
    /// Where the first pose faces.
    pub(crate) facing: f32,
    /// Hears how many codes there are.
    pub(crate) progress: Arc<dyn Progress>,
    /// Hears the motion as it is decoded; it is not kept then.
    pub(crate) listener: Option<Arc<dyn Listener>>,
    /// Checked at every step.
    pub(crate) cancel: CancelToken,
}

impl Job {
    /// Whether there are candidates, and beats to choose between them by.
    pub(crate) fn has_a_choice(&self) -> bool {
        self.candidates > 1 && !self.beats.is_empty()
    }

    /// Whether phrases are judged: to choose between candidates, or to dance them anew.
    pub(crate) fn is_judged(&self) -> bool {
        self.has_a_choice() || self.redo
    }

    /// Dances of a phrase that are tried at once.
    pub(crate) fn tries(&self) -> usize {
        match self.has_a_choice() {
            true => self.candidates,
            false => 1,
        }
    }

    /// Number of codes that lead in, if the dance goes on from another.
    pub(crate) fn lead_in(&self) -> Option<usize> {
        (!self.history.upper.is_empty()).then_some(LEAD_IN)
    }

    /// Dances that are computed side by side for it.
    pub(crate) fn rows(&self) -> usize {
        self.tries() * branches(self.guidance)
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
    /// Decoded motion in world directions, `[frames, 3 joints]`; without frames if somebody listened.
    pub(crate) motion: Array2<f32>,
    /// How far the root has come on the floor, x and z in metres, and where it faces.
    pub(crate) walked: [f32; 2],
    pub(crate) facing: f32,
    /// From submission to the first step.
    pub(crate) queued: Duration,
    /// From the first step to the last frame.
    pub(crate) inference: Duration,
}

enum Ticket {
    Dance {
        job: Box<Job>,
        submitted: Instant,
        reply: Reply,
    },
    /// Codes to decode, and where their motion goes.
    Decode(Codes, Sender<Result<Array2<f32>>>),
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
        observer: Arc<dyn Observer>,
    ) -> Result<Self> {
        let queue = Arc::new(Queue::new(capacity));
        let guard = AbandonOnDrop(Arc::clone(&queue));
        let (ready, loaded) = bounded(1);
        thread::Builder::new()
            .name("model".into())
            .spawn(move || {
                // Whatever ends this thread, nobody waits for it any longer.
                let guard = guard;
                let loaded = Sessions::load(directory, threads);
                match loaded.and_then(|sessions| sessions.tried(rows, observer)) {
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
        let number = self.push(Ticket::Dance {
            job: Box::new(job),
            submitted: Instant::now(),
            reply: Reply::new(reply),
        })?;
        let result = outcome.recv().map_err(|_| EngineError::Stopped)?;
        // One that was cancelled while it waited gives its place back.
        self.queue.remove(number);
        result
    }

    /// Motion of a few codes, in world directions; waits for its turn between two steps.
    pub(crate) fn decode(&self, codes: Codes) -> Result<Array2<f32>> {
        let (reply, motion) = bounded(1);
        self.push(Ticket::Decode(codes, reply))?;
        motion.recv().map_err(|_| EngineError::Stopped)?
    }

    fn push(&self, ticket: Ticket) -> Result<u64> {
        let number = self.queue.push(ticket).map_err(|refused| match refused {
            Refused::Full => EngineError::QueueFull {
                capacity: self.queue.capacity(),
            },
            Refused::Closed => EngineError::Stopped,
        })?;
        Ok(number)
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

/// Takes requests in whenever they may begin, until the queue is closed and nothing is left to do, or can be done.
fn serve(batch: &mut Batch, queue: &Queue<Ticket>) {
    loop {
        while batch.has_place() {
            let ticket = match batch.is_idle() {
                true => queue.pop(),
                false => queue.try_pop(),
            };
            match ticket {
                Some(Ticket::Dance {
                    job,
                    submitted,
                    reply,
                }) => batch.join(*job, reply, submitted.elapsed()),
                Some(Ticket::Decode(codes, reply)) => {
                    // A receiver that has gone only means that nobody waits any more.
                    let _ = reply.send(batch.show(&codes));
                }
                None if batch.is_idle() => return,
                None => break,
            }
        }
        batch.round();
        if batch.has_stopped() {
            return;
        }
    }
}
