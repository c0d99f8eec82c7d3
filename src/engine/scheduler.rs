//! Continuous batching: requests at different places of their songs share every step of the model,
//! and come and go between steps.

use std::{
    collections::{HashMap, VecDeque},
    sync::Arc,
    time::{Duration, Instant},
};

use crossbeam_channel::Sender;
use parking_lot::Mutex;

use super::{
    EngineError,
    code_model::{CodeModel, SharedDecoder},
    completion::Completion,
    decoding::{ChunkTask, DecodeTask, LastChunk, MotionBuffer},
    observer::{Observer, guarded},
    queue::Entry,
    sequence::{Sequence, SequenceRequest},
};
use crate::model::{ModelDirectory, NextStep};

#[cfg(test)]
mod tests;

/// Steps for which a request may be passed over by smaller ones that fit: about a segment. Then
/// rows are kept free for it.
const MOST_PASSED_OVER: usize = 32;

/// A request that is ahead of another by more of the model's time rests, from the end of a segment
/// on, until that one has caught up: as much as half a minute of dance takes by itself, so that
/// only long or wide requests rest, and short ones beside them are not slowed down by their rows.
const MOST_AHEAD: Duration = Duration::from_millis(300);

/// A conditioned request on its way to the scheduler.
pub(crate) struct ScheduledRequest {
    pub(crate) sequence: SequenceRequest,
    pub(crate) motion: MotionBuffer,
    pub(crate) completion: Arc<Completion>,
    /// When it was put into the queue.
    pub(crate) submitted: Instant,
    /// Whose it is.
    pub(crate) owner: u64,
}

impl Entry for ScheduledRequest {
    fn is_wanted(&self) -> bool {
        self.completion.is_wanted()
    }
}

/// All requests that have begun, and the model that they share.
pub(crate) struct Scheduler {
    model: Box<dyn CodeModel>,
    decoder: SharedDecoder,
    directory: Arc<ModelDirectory>,
    /// Share the next step. Their rows of the cache lie one after another in this order.
    running: Vec<Request>,
    /// Wait for rows: new requests, and preempted ones. The one with the least time so far
    /// is next.
    waiting: VecDeque<Request>,
    /// The time that a new request is taken to have had: as much as who had the least of those
    /// present, so that it neither waits for them nor makes them wait for ever.
    least_spent: Duration,
    /// The decoder thread.
    decoding: Sender<DecodeTask>,
    /// The decoder thread has ended, which only a defect of ours can cause.
    stopped: bool,
    observer: Arc<dyn Observer>,
}

/// A request that has begun.
struct Request {
    sequence: Sequence,
    motion: Arc<Mutex<MotionBuffer>>,
    completion: Arc<Completion>,
    owner: u64,
    /// The model's time that it has had: its rows' part of every step, times the number of requests
    /// that its owner has at once.
    spent: Duration,
    /// Of it not counted yet.
    prefilled: Duration,
    /// Time in the queue, and then until it first found rows.
    queued: Duration,
    joined: Instant,
    /// When it first found rows.
    started: Option<Instant>,
    /// Took no step since it last found rows.
    fresh: bool,
    /// Steps that began while it was the first to wait, and did not fit.
    passed_over: usize,
}

impl Request {
    /// Whether it has had so much more than `least` that it rests, given how many each owner has.
    fn is_ahead(&self, least: Duration, owned: &HashMap<u64, u32>) -> bool {
        self.spent > least + MOST_AHEAD * owned[&self.owner]
    }

    fn next_chunk(&mut self) -> Option<ChunkTask> {
        let chunk = self.sequence.next_chunk()?;
        Some(ChunkTask {
            motion: Arc::clone(&self.motion),
            completion: Arc::clone(&self.completion),
            chunk,
            last: self.sequence.finished_codes().map(|codes| LastChunk {
                codes,
                queued: self.queued,
                started: self.started.unwrap_or(self.joined),
            }),
        })
    }
}

impl Scheduler {
    /// Without requests.
    pub(crate) fn new(
        model: Box<dyn CodeModel>,
        decoder: SharedDecoder,
        directory: Arc<ModelDirectory>,
        decoding: Sender<DecodeTask>,
        observer: Arc<dyn Observer>,
    ) -> Self {
        Self {
            model,
            decoder,
            directory,
            running: Vec::new(),
            waiting: VecDeque::new(),
            least_spent: Duration::ZERO,
            decoding,
            stopped: false,
            observer,
        }
    }

    /// Whether one more request may begin. As many as there are rows may wait for rows, so that
    /// the number of begun ones is bounded, and that a request begins beside ones that hold all
    /// rows for long.
    pub(crate) fn has_place(&self) -> bool {
        self.waiting.len() < self.model.rows()
    }

    /// Whether there are no codes to choose.
    pub(crate) fn is_idle(&self) -> bool {
        self.running.is_empty() && self.waiting.is_empty()
    }

    /// Whether no motion can be made any more.
    pub(crate) fn has_stopped(&self) -> bool {
        self.stopped
    }

    /// Takes a request.
    pub(crate) fn add(&mut self, request: ScheduledRequest) {
        let ScheduledRequest { sequence, motion, completion, submitted, owner } = request;
        let sequence = guarded(|| Ok(Sequence::new(sequence, self.directory.manifest())));
        let spent = self.least_spent();
        match sequence {
            Ok(sequence) => self.waiting.push_back(Request {
                sequence,
                motion: Arc::new(Mutex::new(motion)),
                completion,
                owner,
                spent,
                prefilled: Duration::ZERO,
                queued: submitted.elapsed(),
                joined: Instant::now(),
                started: None,
                fresh: true,
                passed_over: 0,
            }),
            Err(error) => completion.complete(Err(error)),
        }
    }

    /// One step of every running request.
    pub(crate) fn step(&mut self) {
        self.drop_unwanted();
        self.rest();
        self.admit();
        self.prefill();
        if self.running.is_empty() {
            return;
        }
        let started = Instant::now();
        let stepped = guarded(|| {
            let requests = self.running.iter();
            let next = requests.flat_map(|request| request.sequence.next_steps());
            let next: Vec<NextStep<'_>> = next.collect();
            Ok(self.model.step(&next)?)
        });
        let (rows, time) = (self.rows_before(self.running.len()), started.elapsed());
        self.observer.stepped(rows, time);
        self.charge(time, rows);
        let logits = match stepped {
            Ok(logits) => logits,
            Err(error) => return self.fail_all(&error),
        };
        // A committed segment may begin one of as many rows, or none: no row moves meanwhile.
        let (decoder, directory) = (self.decoder.clone(), Arc::clone(&self.directory));
        self.each(|_, first, request| {
            request.sequence.choose(&logits, first)?;
            request.sequence.commit(&decoder, directory.manifest())
        });
        for request in &mut self.running {
            request.fresh = false;
        }
        self.send_chunks();
    }

    /// Drops cancelled requests, and those whose motion could not be made.
    fn drop_unwanted(&mut self) {
        self.waiting.retain(|request| request.completion.is_wanted());
        let unwanted = |request: &Request| !request.completion.is_wanted();
        while let Some(place) = self.running.iter().position(unwanted) {
            self.take_out(place);
        }
    }

    /// The least time that one of those present has had, or had when there was one.
    fn least_spent(&mut self) -> Duration {
        let present = self.running.iter().chain(&self.waiting);
        let least = present.map(|request| request.spent).min();
        self.least_spent = self.least_spent.max(least.unwrap_or_default());
        self.least_spent
    }

    /// Stops running requests at a segment's start that are too far ahead of another one.
    fn rest(&mut self) {
        let owned = self.owned();
        let limit = self.least_spent();
        let rests = |request: &Request| {
            let resting = !request.fresh && request.sequence.can_be_preempted();
            resting && request.is_ahead(limit, &owned)
        };
        while let Some(place) = self.running.iter().position(rests) {
            self.put_back(place);
        }
    }

    /// Admits the waiting request with the least time so far, and of equal ones the oldest.
    /// Where it does not fit, running requests at a segment's start
    /// are preempted if that makes room for it, so that a long song never blocks the others; else
    /// smaller ones that fit are admitted before it, for a while.
    fn admit(&mut self) {
        let (least, owned) = (self.least_spent(), self.owned());
        let rests = |request: &Request| request.is_ahead(least, &owned);
        loop {
            self.waiting.make_contiguous().sort_by_key(|request| request.spent);
            let Some(first) = self.waiting.front().filter(|first| !rests(first)) else {
                break;
            };
            let (need, spent) = (first.sequence.rows(), first.spent);
            let patient = first.passed_over < MOST_PASSED_OVER;
            if need > self.free_rows() && !self.preempt_for(need, spent, patient) {
                break;
            }
            self.start(0);
        }
        let Some(first) = self.waiting.front_mut().filter(|first| !rests(first)) else {
            return;
        };
        first.passed_over += 1;
        if first.passed_over > MOST_PASSED_OVER {
            return;
        }
        let mut free = self.free_rows();
        let fits = |one: &Request, free| one.sequence.rows() <= free && !rests(one);
        while let Some(place) = self.waiting.iter().position(|one| fits(one, free)) {
            self.start(place);
            free = self.free_rows();
        }
    }

    /// Preempts requests that have had more than `spent` until `need` rows are free, and whether
    /// they are. With `patient`, nothing is preempted unless that is enough.
    fn preempt_for(&mut self, need: usize, spent: Duration, patient: bool) -> bool {
        let may = |request: &Request| {
            !request.fresh && request.spent > spent && request.sequence.can_be_preempted()
        };
        let candidates = self.running.iter().filter(|request| may(request));
        let freed: usize = candidates.map(|request| request.sequence.rows()).sum();
        if patient && self.free_rows() + freed < need {
            return false;
        }
        while self.free_rows() < need {
            let candidates = self.running.iter().enumerate().filter(|(_, request)| may(request));
            let Some((place, _)) = candidates.max_by_key(|(_, request)| request.spent) else {
                return false;
            };
            self.put_back(place);
        }
        true
    }

    /// Lets a running request wait again.
    fn put_back(&mut self, place: usize) {
        let request = self.take_out(place);
        self.waiting.push_back(Request { fresh: true, passed_over: 0, ..request });
    }

    /// Gives a waiting request its rows, the last ones.
    fn start(&mut self, place: usize) {
        self.running.extend(self.waiting.remove(place).map(|mut request| {
            if request.started.is_none() {
                request.queued += request.joined.elapsed();
                request.started = Some(Instant::now());
            }
            request
        }));
    }

    fn free_rows(&self) -> usize {
        self.model.rows() - self.rows_before(self.running.len())
    }

    /// Rows of the running requests before a place.
    fn rows_before(&self, place: usize) -> usize {
        let before = self.running.iter().take(place);
        before.map(|request| request.sequence.rows()).sum()
    }

    /// Takes a running request out; the rows of those after it move up.
    fn take_out(&mut self, place: usize) -> Request {
        let first = self.rows_before(place);
        let all = self.rows_before(self.running.len());
        let request = self.running.remove(place);
        self.model.copy(first + request.sequence.rows()..all, first);
        request
    }

    fn prefill(&mut self) {
        self.each(|model, first, request| {
            let started = Instant::now();
            request.sequence.prefill(model, first)?;
            request.prefilled = started.elapsed();
            Ok(())
        });
    }

    /// Counts the time of a step of `rows` as that of the requests in it, each for its rows and for
    /// what it filled the cache with before.
    fn charge(&mut self, time: Duration, rows: usize) {
        let owned = self.owned();
        for request in &mut self.running {
            let own = time.mul_f64(request.sequence.rows() as f64 / rows.max(1) as f64);
            let own = own + std::mem::take(&mut request.prefilled);
            request.spent += own * owned[&request.owner];
        }
    }

    /// The number of requests that each owner has at once.
    fn owned(&self) -> HashMap<u64, u32> {
        let mut owned = HashMap::new();
        for request in self.running.iter().chain(&self.waiting) {
            *owned.entry(request.owner).or_default() += 1;
        }
        owned
    }

    /// Does `work` for every running request, given its first row. One that fails, or panics,
    /// leaves alone.
    fn each(
        &mut self,
        mut work: impl FnMut(&mut dyn CodeModel, usize, &mut Request) -> Result<(), EngineError>,
    ) {
        let mut failed = Vec::new();
        let mut first = 0;
        for (place, request) in self.running.iter_mut().enumerate() {
            // Also after a panic, as many rows are to be taken out.
            let rows = request.sequence.rows();
            let done = guarded(|| work(&mut *self.model, first, request));
            if let Err(error) = done {
                request.completion.complete(Err(error));
                failed.push(place);
            }
            first += rows;
        }
        // From the last on, so that the places before stay.
        for place in failed.into_iter().rev() {
            self.take_out(place);
        }
    }

    /// Sends the chunks whose codes are committed to the decoder thread. With the last one, which
    /// completes the request, nothing is left of it here.
    fn send_chunks(&mut self) {
        let mut place = 0;
        while let Some(request) = self.running.get_mut(place) {
            let Some(chunk) = request.next_chunk() else {
                place += 1;
                continue;
            };
            if chunk.last.is_some() {
                drop(self.take_out(place));
            }
            let sent = self.decoding.send(DecodeTask::Chunk(chunk));
            self.stopped |= sent.is_err();
        }
    }

    /// A shared step that fails is everybody's.
    fn fail_all(&mut self, error: &EngineError) {
        let cause = error.to_string();
        tracing::error!(cause, "a step of the model failed");
        self.observer.step_failed();
        for request in self.running.drain(..) {
            let cause = cause.clone();
            let failed = EngineError::StepFailed { cause };
            request.completion.complete(Err(failed));
        }
    }
}
