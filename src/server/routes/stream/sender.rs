//! The events of a stream, made of what the work tells when the connection asks for them.

use std::time::Duration;

use bytes::Bytes;
use futures_util::{Stream, stream};
use tokio::{sync::mpsc, time::Instant};

use super::opened::{Event, Opened};
use crate::{
    engine::{EngineError, GenerationOutput, Opening},
    formats::{JsonOptions, Start, done_event, frames_event, start_event},
    motion::{Finished, Finisher, MotionError},
    server::{
        blocking::blocking,
        error::{ErrorEvent, ServerError},
        resources::Reservation,
        state::SharedState,
        tracker::Waiting,
    },
};

/// Writes events as one of the two media types.
#[derive(Clone, Copy)]
struct Writer {
    lines: bool,
}

impl Writer {
    fn event(self, name: &str, json: &[u8]) -> Bytes {
        let mut text = Vec::with_capacity(json.len() + 32);
        if !self.lines {
            text.extend(b"event: ");
            text.extend(name.as_bytes());
            text.extend(b"\ndata: ");
        }
        text.extend(json);
        text.extend(if self.lines { &b"\n"[..] } else { b"\n\n" });
        text.into()
    }
}

/// Makes the next event when the connection asks for it: a slow reader slows nobody else.
pub(super) struct Sender {
    writer: Writer,
    json: JsonOptions,
    state: SharedState,
    request_id: String,
    /// The event `start`, until it is asked for.
    start: Option<Bytes>,
    events: mpsc::UnboundedReceiver<Event>,
    finisher: Option<Finisher>,
    sent: usize,
    /// Making frames of decoded motion, all together.
    motion: Duration,
    waiting: Option<Waiting>,
    _held: (Box<dyn Send>, Reservation),
}

impl Sender {
    /// `under_way` counts the stream as a request until its end has been sent.
    pub(super) fn new(
        state: SharedState,
        request_id: String,
        opened: Opened,
        under_way: impl Send + 'static,
    ) -> Result<Self, ServerError> {
        let Opened { order, opening, events, room } = opened;
        let writer = Writer { lines: order.shape.lines };
        let json = order.options.writing().json;
        let start = start_event(&start_of(&opening), &json)?;
        Ok(Self {
            writer,
            json,
            state,
            request_id,
            start: Some(writer.event("start", &start)),
            events,
            finisher: Some(opening.finisher),
            sent: 0,
            motion: Duration::ZERO,
            waiting: Some(order.waiting),
            _held: (Box::new(under_way), room),
        })
    }

    /// All events, to the last one.
    pub(super) fn events(self) -> impl Stream<Item = Bytes> + Send + 'static {
        stream::unfold(Some(self), |sender| async move {
            let mut sender = sender?;
            let (event, goes_on) = sender.next().await;
            Some((event, goes_on.then_some(sender)))
        })
    }

    /// The next event, and whether there are more.
    async fn next(&mut self) -> (Bytes, bool) {
        if let Some(start) = self.start.take() {
            return (start, true);
        }
        match self.try_next().await {
            Ok(next) => next,
            Err(error) => {
                let report = error.report();
                self.state.metrics.rejected(&report.error_type);
                // Stops the work, if it has not ended.
                self.events.close();
                self.waiting = None;
                let event = ErrorEvent::new(&report, &self.request_id);
                let json = serde_json::to_vec(&event).unwrap_or_default();
                (self.writer.event("error", &json), false)
            }
        }
    }

    async fn try_next(&mut self) -> Result<(Bytes, bool), ServerError> {
        loop {
            match self.events.recv().await {
                Some(Event::Frames(motion)) => {
                    let frames = self.finish(move |finisher| finisher.push(motion.view()));
                    if let Some(event) = frames.await? {
                        return Ok((event, true));
                    }
                }
                Some(Event::Ended(ended)) => match *ended {
                    Ok(output) => return self.end(output).await,
                    Err(error) => {
                        if !error.stops_work() {
                            self.answered();
                        }
                        return Err(error);
                    }
                },
                Some(Event::Opened(_)) => {}
                None => return Err(ServerError::Internal("a dance did not end".to_owned())),
            }
        }
    }

    /// The last frames and the end of the dance, in one piece: they are few.
    async fn end(&mut self, output: GenerationOutput) -> Result<(Bytes, bool), ServerError> {
        let frames = self.finish(Finisher::end).await?;
        let mut last = frames.map_or_else(Vec::new, Vec::from);
        let mut timings = output.timings;
        timings.motion = self.motion;
        self.state.metrics.stage("motion", self.motion);
        let seam = self.finisher.as_ref().and_then(Finisher::seam);
        let tail = output.tail.map(|tail| tail.with_seam(seam));
        let done = done_event(self.sent, &output.codes, tail.as_ref(), timings);
        last.extend(self.writer.event("done", &done?));
        self.answered();
        Ok((last.into(), false))
    }

    /// Finishes decoded motion, and makes an event of the frames if there are any. Runs on a
    /// blocking thread: rotations, the floor and the text of some seconds.
    async fn finish(
        &mut self,
        make: impl FnOnce(&mut Finisher) -> Result<Finished, MotionError> + Send + 'static,
    ) -> Result<Option<Bytes>, ServerError> {
        let gone = || ServerError::Internal("a dance was finished twice".to_owned());
        let mut finisher = self.finisher.take().ok_or_else(gone)?;
        let (sent, json, writer) = (self.sent, self.json, self.writer);
        let span = tracing::info_span!("stage", otel.name = "motion");
        let started = Instant::now();
        let finish = move || {
            let _entered = span.entered();
            let part = make(&mut finisher).map_err(EngineError::from)?;
            let count = part.animation.root.len();
            let event = match count {
                0 => None,
                _ => {
                    let frames = frames_event(&part, sent, &json)?;
                    Some(writer.event("frames", &frames))
                }
            };
            Ok((finisher, count, event))
        };
        let finished = blocking(&self.state.metrics, "motion", finish).await;
        self.motion += started.elapsed();
        let (finisher, count, event) = finished?;
        self.finisher = Some(finisher);
        self.sent += count;
        Ok(event)
    }

    fn answered(&mut self) {
        if let Some(waiting) = self.waiting.take() {
            waiting.answered();
        }
    }
}

fn start_of(opening: &Opening) -> Start<'_> {
    Start {
        model: &opening.model,
        seed: opening.seed,
        fps: opening.fps,
        frames: opening.frames,
        skeleton: &opening.skeleton,
        style: opening.style.as_deref(),
        music: opening.music.as_ref(),
        timings: opening.timings,
        warnings: &opening.warnings,
        positions_source: opening.positions_source,
    }
}
