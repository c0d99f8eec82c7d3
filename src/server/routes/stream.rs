//! `POST /generate/stream`: a dance while it is made.

use std::{sync::Arc, time::Duration};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, header},
    response::{IntoResponse, Response},
};
use bytes::Bytes;
use futures_util::stream;
use ndarray::Array2;
use tokio::{sync::mpsc, time::Instant};

use crate::{
    engine::{Ending, Listener, Opening, Progress, Stage},
    format::{FormatError, JsonOptions, Start, done_event, frames_event, start_event},
    motion::{Finished, Finisher, MotionError},
    server::{
        body::IncomingBody,
        envelope::request_id,
        error::{ErrorBody, ErrorEvent, ServerError},
        intake::{self, Order, Purpose},
        negotiate::{EVENTS, LINES},
        options::{AudioFile, GenerateForm, RequestOptions},
        outgoing,
        room::Share,
        routes::generate::{SEED, times},
        state::SharedState,
        warnings,
        watch::{Presence, Watch},
        work,
    },
};

/// Bytes of one frame of decoded motion that waits for a reader: joints and a turn, as float32.
const FRAME_BYTES: u64 = 73 * 4;
const FRAMES_PER_SECOND: u64 = 60;

/// Generates a dance and sends it while it is made.
///
/// The same input as `POST /generate`. All checks, decoding and music features happen before the answer
/// begins; then come one `start` event, `frames` events with the dance's frames in order, and one `done`
/// event, or an `error` event if something goes wrong meanwhile. Server-sent events by default; with
/// `Accept: application/x-ndjson` the same objects as lines. Frames are those of `POST /generate` with the
/// same seed, but for a centimetre or two of height: where the floor is, is told from 2.5 s ahead.
#[utoipa::path(
    post,
    path = "/generate/stream",
    tag = "dance",
    params(RequestOptions),
    request_body(
        description = "The song: wav, flac, mp3, ogg/vorbis or m4a/aac, told from its bytes.",
        content(
            (GenerateForm = "multipart/form-data"),
            (AudioFile = "audio/*"),
            (AudioFile = "application/octet-stream")
        )
    ),
    responses(
        (
            status = 200,
            description = "Events: objects of the schemas StartEvent, FramesEvent, DoneEvent and ErrorEvent.",
            content((String = "text/event-stream"), (String = "application/x-ndjson")),
            headers(
                ("x-seed" = u64, description = "The seed that is used."),
                ("x-queue-time" = f64, description = "Milliseconds spent waiting for a place to work in."),
                ("x-decode-time" = f64, description = "Milliseconds of decoding the audio."),
                ("x-feature-time" = f64, description = "Milliseconds of music features."),
                ("x-warnings" = String, description = "As in `POST /generate`."),
                ("x-request-id" = String, description = "The request's id."),
            )
        ),
        (status = 400, description = "An option or the form is wrong, or there is no audio.", body = ErrorBody),
        (status = 401, description = "An API key is needed, or the one that was sent is not known.", body = ErrorBody),
        (status = 406, description = "The Accept header names neither kind of events.", body = ErrorBody),
        (status = 408, description = "The body was not sent in time.", body = ErrorBody),
        (status = 413, description = "The audio file is too large.", body = ErrorBody),
        (status = 415, description = "The body is no audio that is accepted, or compressed.", body = ErrorBody),
        (status = 422, description = "The audio cannot be decoded, or is too short or too long.", body = ErrorBody),
        (
            status = 429,
            description = "Too many requests are waiting, too much is being uploaded, or this client asks too often.",
            body = ErrorBody,
            headers(("retry-after" = u64, description = "Seconds to wait."))
        ),
        (status = 500, description = "The server is at fault.", body = ErrorBody),
        (
            status = 503,
            description = "The model is being loaded, the server is shutting down, or there was no result in time.",
            body = ErrorBody,
            headers(("retry-after" = u64, description = "Seconds to wait."))
        ),
    ),
    security((), ("bearer" = []), ("api_key" = []))
)]
pub(crate) async fn stream(
    State(state): State<SharedState>,
    request: Request,
) -> Result<Response, ServerError> {
    let until = Instant::now() + state.limits.request_timeout.0;
    let request_id = request_id(&request).to_owned();
    let (parts, body) = request.into_parts();
    let body = IncomingBody::new(body);
    let under_way = state.lifecycle.enter().ok_or_else(|| state.draining())?;
    let opened = state.in_time(open(&state, parts, body, until)).await?;
    let Opened {
        order,
        opening,
        waited,
        events,
        room,
    } = opened;
    let mut headers = HeaderMap::new();
    let kind = if order.shape.lines { LINES } else { EVENTS };
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(SEED, HeaderValue::from(opening.seed));
    let mut timings = opening.timings;
    timings.queue += waited;
    times(&mut headers, &timings);
    headers.remove("x-inference-time");
    warnings::append(&mut headers, &opening.warnings);

    let json = order.options.json();
    let writer = Writer {
        lines: order.shape.lines,
    };
    let start = start_event(&begin(&opening, timings), &json).map_err(of_format)?;
    let patience = state.limits.answer_idle_timeout.0;
    let sender = Sender {
        writer,
        json,
        state,
        request_id,
        waited,
        motion: Duration::ZERO,
        events,
        finisher: Some(opening.finisher),
        sent: 0,
        presence: Some(order.presence),
        _held: (Box::new(under_way), room),
    };
    let first = Some(writer.event("start", &start));
    let body = stream::unfold(Some((first, sender)), |next| async move {
        let (first, mut sender) = next?;
        if let Some(first) = first {
            return Some((first, Some((None, sender))));
        }
        let (event, goes_on) = sender.next().await;
        Some((event, goes_on.then_some((None, sender))))
    });
    Ok((headers, outgoing::attended(body, patience)).into_response())
}

/// A dance that has begun.
struct Opened {
    order: Order,
    opening: Opening,
    waited: Duration,
    events: mpsc::UnboundedReceiver<Event>,
    room: Share,
}

/// What the work tells the answer. All of a dance fits into the share of answers that is held for it.
enum Event {
    Opened(Box<Opening>),
    Frames(Array2<f32>),
    Ended(Box<Result<Ending, ServerError>>),
}

async fn open(
    state: &SharedState,
    parts: axum::http::request::Parts,
    body: IncomingBody,
    until: Instant,
) -> Result<Opened, ServerError> {
    let mut order = intake::receive(state, Purpose::Stream, parts, body).await?;
    let opened = async {
        let permit = state.admission.admit_traced().await?;
        let waited = permit.waited;
        order.hold_audio(state).await?;
        let longest = state.limits.max_audio_seconds;
        let seconds = order.options.longest_seconds().unwrap_or(longest);
        let frames = seconds.min(longest).ceil() as u64 * FRAMES_PER_SECOND;
        let room = state.room((frames * FRAME_BYTES) as usize).await?;
        let (sender, mut events) = mpsc::unbounded_channel();
        let listener = Arc::new(Forward {
            watch: Arc::clone(&order.watch),
            sender: sender.clone(),
        });
        let work = order.work();
        let shared = Arc::clone(state);
        let span = tracing::Span::current();
        tokio::spawn(tracing::Instrument::instrument(
            async move {
                let work = work::stream(&shared.metrics, work, permit, listener);
                let ended = tokio::select! {
                    ended = tokio::time::timeout_at(until, work) => {
                        ended.unwrap_or_else(|_| Err(shared.timeout()))
                    }
                    () = shared.lifecycle.aborted() => Err(shared.draining()),
                };
                // Nobody listens where the client has gone.
                let _ = sender.send(Event::Ended(Box::new(ended)));
            },
            span,
        ));
        match events.recv().await {
            Some(Event::Opened(opening)) => Ok((*opening, waited, events, room)),
            Some(Event::Ended(ended)) => Err(match *ended {
                Err(error) => error,
                Ok(_) => ServerError::Internal("a dance ended before it began".to_owned()),
            }),
            _ => Err(ServerError::Internal("a dance did not begin".to_owned())),
        }
    }
    .await;
    match opened {
        Ok((opening, waited, events, room)) => Ok(Opened {
            order,
            opening,
            waited,
            events,
            room,
        }),
        Err(error) => {
            order.presence.answered();
            Err(error)
        }
    }
}

fn begin(opening: &Opening, timings: crate::format::Timings) -> Start<'_> {
    Start {
        model: &opening.model,
        seed: opening.seed,
        fps: opening.fps,
        frames: opening.frames,
        skeleton: &opening.skeleton,
        music: opening.music.as_ref(),
        timings,
        warnings: &opening.warnings,
        positions_source: opening.positions_source,
    }
}

fn of_format(error: FormatError) -> ServerError {
    ServerError::Dance(error.into())
}

/// Passes on what the engine tells.
struct Forward {
    watch: Arc<Watch>,
    sender: mpsc::UnboundedSender<Event>,
}

impl Progress for Forward {
    fn stage(&self, stage: Stage) {
        self.watch.stage(stage);
    }

    fn decoded(&self, seconds: f64) {
        self.watch.decoded(seconds);
    }

    fn codes(&self, done: usize, total: usize) {
        self.watch.codes(done, total);
    }
}

impl Listener for Forward {
    fn opened(&self, opening: Opening) {
        // Nobody listens where the client has gone; the work is cancelled then.
        let _ = self.sender.send(Event::Opened(Box::new(opening)));
    }

    fn frames(&self, motion: Array2<f32>) {
        let _ = self.sender.send(Event::Frames(motion));
    }
}

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

/// Makes the next event when the connection asks for it: who reads slowly slows nobody else.
struct Sender {
    writer: Writer,
    json: JsonOptions,
    state: SharedState,
    request_id: String,
    waited: Duration,
    events: mpsc::UnboundedReceiver<Event>,
    finisher: Option<Finisher>,
    sent: usize,
    /// Making frames of decoded motion, all together.
    motion: Duration,
    presence: Option<Presence>,
    _held: (Box<dyn Send>, Share),
}

impl Sender {
    /// The next event, and whether there are more.
    async fn next(&mut self) -> (Bytes, bool) {
        match self.try_next().await {
            Ok(next) => next,
            Err(error) => {
                let report = error.report();
                self.state.metrics.rejected(report.error_type);
                // Stops the work, if it goes on still.
                self.presence = None;
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
                    Ok(ending) => return self.end(ending).await,
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
    async fn end(&mut self, ending: Ending) -> Result<(Bytes, bool), ServerError> {
        let frames = self.finish(Finisher::end).await?;
        let mut last = frames.map_or_else(Vec::new, Vec::from);
        let mut timings = ending.timings;
        timings.queue += self.waited;
        timings.motion = self.motion;
        self.state.metrics.stage("motion", self.motion);
        let done = done_event(self.sent, &ending.codes, ending.tail.as_ref(), timings);
        last.extend(self.writer.event("done", &done.map_err(of_format)?));
        self.answered();
        Ok((last.into(), false))
    }

    /// Makes frames of decoded motion, and an event of them if there are any. Runs on a blocking thread:
    /// rotations, the floor and the text of some seconds.
    async fn finish(
        &mut self,
        work: impl FnOnce(&mut Finisher) -> Result<Finished, MotionError> + Send + 'static,
    ) -> Result<Option<Bytes>, ServerError> {
        let gone = || ServerError::Internal("a dance was finished twice".to_owned());
        let mut finisher = self.finisher.take().ok_or_else(gone)?;
        let (sent, json, writer) = (self.sent, self.json, self.writer);
        let span = tracing::info_span!("stage", otel.name = "motion");
        let started = Instant::now();
        let finished = tokio::task::spawn_blocking(move || {
            let _entered = span.entered();
            let part = work(&mut finisher)?;
            let count = part.animation.root.len();
            let event = match count {
                0 => None,
                _ => Some(writer.event("frames", &frames_event(&part, sent, &json)?)),
            };
            Ok::<_, crate::Error>((finisher, count, event))
        })
        .await;
        self.motion += started.elapsed();
        let (finisher, count, event) = finished.map_err(|failed| {
            self.state.metrics.panicked("motion");
            ServerError::Internal(failed.to_string())
        })??;
        self.finisher = Some(finisher);
        self.sent += count;
        Ok(event)
    }

    fn answered(&mut self) {
        if let Some(presence) = self.presence.take() {
            presence.answered();
        }
    }
}
