//! Continuous batching: requests at different places of their songs share every step of the model, and
//! come and go between steps.

use std::{
    collections::VecDeque,
    sync::Arc,
    time::{Duration, Instant},
};

use ndarray::Array2;
use parking_lot::Mutex;

use super::{
    EngineError,
    error::of_model,
    frames::{End, Footage, Frames, Take},
    observer::{Observer, guarded},
    piece::Piece,
    reply::Reply,
    sessions::Sessions,
    worker::Job,
};
use crate::{CancelToken, Result, formats::Codes, model::GptMemory};

/// Requests in the making, and the model that makes them.
pub(crate) struct Batch {
    sessions: Sessions,
    memory: GptMemory,
    /// Share the next step. Their rows of memory lie behind one another in this order.
    dancing: Vec<Seat>,
    /// Wait for rows: new ones, and ones that made room at the end of a phrase. First come, first served.
    line: VecDeque<Seat>,
    /// Makes frames of their codes.
    frames: Frames,
    /// They cannot be made any more.
    stopped: bool,
    observer: Arc<dyn Observer>,
}

/// A request and who waits for it.
struct Seat {
    piece: Piece,
    footage: Arc<Mutex<Footage>>,
    reply: Arc<Reply>,
    /// Waiting, until it first found rows.
    queued: Duration,
    joined: Instant,
    started: Option<Instant>,
    /// Took no step since it came in from the line.
    fresh: bool,
}

impl Batch {
    /// Nothing to do yet; at most `rows` dances share a step.
    ///
    /// # Errors
    /// As [`Frames::start`].
    pub(crate) fn new(
        sessions: Sessions,
        rows: usize,
        observer: Arc<dyn Observer>,
    ) -> Result<Self> {
        let decoder = sessions.decoder.clone();
        Ok(Self {
            memory: sessions.gpt.memory(rows),
            sessions,
            dancing: Vec::new(),
            line: VecDeque::new(),
            frames: Frames::start(decoder, rows, Arc::clone(&observer))?,
            stopped: false,
            observer,
        })
    }

    /// Whether one more request may begin. As many as there are rows may do without one for now, so that
    /// what is begun is bounded, and that a request finds a place beside ones that hold all rows for long.
    pub(crate) fn has_place(&self) -> bool {
        self.line.len() < self.memory.rows()
    }

    /// Whether there are no codes to choose.
    pub(crate) fn is_idle(&self) -> bool {
        self.dancing.is_empty() && self.line.is_empty()
    }

    /// Whether nothing can be made any more.
    pub(crate) fn has_stopped(&self) -> bool {
        self.stopped
    }

    /// Lets a request join after it waited for `queued`.
    pub(crate) fn join(&mut self, job: Job, reply: Reply, queued: Duration) {
        let manifest = self.sessions.directory.manifest();
        let job = Arc::new(job);
        let begun = guarded(&*self.observer, || {
            let footage = Footage::new(Arc::clone(&job), manifest);
            Ok((Piece::new(job, manifest), Arc::new(Mutex::new(footage))))
        });
        match begun {
            Ok((piece, footage)) => self.line.push_back(Seat {
                piece,
                footage,
                reply: Arc::new(reply),
                queued,
                joined: Instant::now(),
                started: None,
                fresh: true,
            }),
            Err(error) => reply.give(Err(error)),
        }
    }

    /// Decodes a few codes, in world directions.
    pub(crate) fn show(&mut self, codes: &Codes) -> Result<Array2<f32>> {
        let sessions = &self.sessions;
        guarded(&*self.observer, || {
            let never = CancelToken::new();
            let motion = sessions
                .decoder
                .lock()
                .decode(&codes.upper, &codes.lower, &never)
                .map_err(of_model)?;
            let frame = sessions.directory.manifest().motion_frame;
            Ok(frame.into_world(motion)?)
        })
    }

    /// One step of every dance that has rows.
    pub(crate) fn round(&mut self) {
        self.leave_if_over();
        self.make_room();
        self.step();
    }

    /// Who was cancelled leaves, and whose frames could not be made.
    fn leave_if_over(&mut self) {
        let stays = |seat: &Seat| {
            let cancelled = seat.piece.job().cancel.is_cancelled();
            if cancelled {
                // The cancellation itself may not have come to say so yet.
                seat.reply.give(Err(EngineError::Cancelled.into()));
            }
            !cancelled && !seat.reply.is_given()
        };
        self.line.retain(stays);
        while let Some(place) = self.dancing.iter().position(|seat| !stays(seat)) {
            self.take_out(place);
        }
    }

    /// Lets in who is first in line. If there are no rows left, who is at the end of a phrase goes to the
    /// line's end: a long song never blocks the others.
    fn make_room(&mut self) {
        while let Some(next) = self.line.front() {
            let free = self.memory.rows() - self.rows_before(self.dancing.len());
            if next.piece.rows() <= free {
                let mut seat = self.line.pop_front();
                if let Some(seat) = seat.as_mut().filter(|seat| seat.started.is_none()) {
                    seat.queued += seat.joined.elapsed();
                    seat.started = Some(Instant::now());
                }
                self.dancing.extend(seat);
                continue;
            }
            let rests = |seat: &Seat| !seat.fresh && seat.piece.can_rest();
            let Some(place) = self.dancing.iter().position(rests) else {
                return;
            };
            let seat = self.take_out(place);
            self.line.push_back(Seat {
                fresh: true,
                ..seat
            });
        }
    }

    /// Rows of those before a place.
    fn rows_before(&self, place: usize) -> usize {
        let before = self.dancing.iter().take(place);
        before.map(|seat| seat.piece.rows()).sum()
    }

    /// Takes one out; the rows of those behind it move up.
    fn take_out(&mut self, place: usize) -> Seat {
        let (first, all) = (
            self.rows_before(place),
            self.rows_before(self.dancing.len()),
        );
        let seat = self.dancing.remove(place);
        self.memory.copy(first + seat.piece.rows()..all, first);
        seat
    }

    fn step(&mut self) {
        self.each(|sessions, memory, first, piece| {
            piece
                .prime(&mut sessions.gpt, memory, first)
                .map_err(of_model)
        });
        if self.dancing.is_empty() {
            return;
        }
        let started = Instant::now();
        let stepped = guarded(&*self.observer, || {
            let seats = self.dancing.iter();
            let next: Vec<_> = seats.flat_map(|seat| seat.piece.next_steps()).collect();
            let gpt = &mut self.sessions.gpt;
            gpt.step(&mut self.memory, &next).map_err(of_model)
        });
        let rows = self.rows_before(self.dancing.len());
        self.observer.stepped(rows, started.elapsed());
        let logits = match stepped {
            Ok(logits) => logits,
            Err(error) => return self.fail_all(&error.to_string()),
        };
        // A phrase that ends may begin one of as many rows, or none: no place changes meanwhile.
        self.each(|sessions, _, first, piece| {
            piece.choose(&logits, first);
            piece.settle(&sessions.decoder, sessions.directory.manifest())
        });
        for seat in &mut self.dancing {
            seat.fresh = false;
        }
        self.make_frames();
        let has_all = |seat: &Seat| seat.piece.has_all_codes();
        while let Some(place) = self.dancing.iter().position(has_all) {
            self.take_out(place);
        }
    }

    /// Sends off the chunks whose codes are settled now; who has all codes gets the answer with the last.
    fn make_frames(&mut self) {
        for seat in &mut self.dancing {
            while let Some(chunk) = seat.piece.next_chunk() {
                let end = seat.piece.end().map(|codes| End {
                    codes,
                    queued: seat.queued,
                    started: seat.started.unwrap_or(seat.joined),
                });
                let made = self.frames.make(Take {
                    footage: Arc::clone(&seat.footage),
                    chunk,
                    end,
                    reply: Arc::clone(&seat.reply),
                });
                self.stopped |= made.is_err();
            }
        }
    }

    /// Does `work` for every dancing piece, given its first row. Whoever fails, or panics, leaves alone.
    fn each(
        &mut self,
        mut work: impl FnMut(&mut Sessions, &mut GptMemory, usize, &mut Piece) -> Result<()>,
    ) {
        let mut failed = Vec::new();
        let mut first = 0;
        for (place, seat) in self.dancing.iter_mut().enumerate() {
            let rows = seat.piece.rows();
            let done = guarded(&*self.observer, || {
                work(&mut self.sessions, &mut self.memory, first, &mut seat.piece)
            });
            if let Err(error) = done {
                seat.reply.give(Err(error));
                failed.push((place, first, rows));
            }
            first += rows;
        }
        // From the last on, so that places and rows of those before stay. What failed says nothing
        // reliable about its rows any more.
        for (place, row, rows) in failed.into_iter().rev() {
            self.dancing.remove(place);
            self.memory.copy(row + rows..first, row);
            first -= rows;
        }
    }

    /// A shared step that fails is everybody's.
    fn fail_all(&mut self, problem: &str) {
        tracing::error!(problem, "a step of the model failed");
        for seat in self.dancing.drain(..) {
            seat.reply.give(Err(EngineError::Panicked.into()));
        }
    }
}
