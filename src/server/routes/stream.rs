//! `POST /generate/stream`: a dance while it is made.

use std::{convert::Infallible, sync::Arc, time::Duration};

use axum::{
    body::Body,
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
    motion::{Finished, Finisher},
    server::{
        body::IncomingBody,
        envelope::request_id,
        error::{ErrorBody, ErrorEvent, ServerError},
        intake::{self, Order, Purpose},
        negotiate::{EVENTS, LINES},
        options::{AudioFile, GenerateForm, RequestOptions},
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
/// same seed, but for millimetres of height: what the floor is, is told from 2.5 s ahead.
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
    let opened = state.in_time(open(&state, parts, body)).await?;
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
    let sender = Sender {
        writer,
        json,
        state,
        request_id,
        until,
        waited,
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
            return Some((Ok::<_, Infallible>(first), Some((None, sender))));
        }
        let (event, goes_on) = sender.next().await;
        Some((Ok(event), goes_on.then_some((None, sender))))
    });
    Ok((headers, Body::from_stream(body)).into_response())
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
) -> Result<Opened, ServerError> {
    let mut order = intake::receive(state, Purpose::Stream, parts, body).await?;
    let opened = async {
        let permit = state.admission.admit().await?;
        let waited = permit.waited;
        order.hold_audio(state).await?;
        let longest = state.limits.max_audio_seconds;
        let seconds = order.options.longest_seconds().unwrap_or(longest);
        let frames = seconds.min(longest).ceil() as u64 * FRAMES_PER_SECOND;
        let room = state.answers.share(frames * FRAME_BYTES).await?;
        let (sender, mut events) = mpsc::unbounded_channel();
        let listener = Arc::new(Forward {
            watch: Arc::clone(&order.watch),
            sender: sender.clone(),
        });
        let work = order.work();
        let metrics = Arc::clone(&state.metrics);
        let span = tracing::Span::current();
        tokio::spawn(tracing::Instrument::instrument(
            async move {
                let ended = work::stream(&metrics, work, permit, listener).await;
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
    until: Instant,
    waited: Duration,
    events: mpsc::UnboundedReceiver<Event>,
    finisher: Option<Finisher>,
    sent: usize,
    presence: Option<Presence>,
    _held: (Box<dyn Send>, Share),
}

impl Sender {
    /// The next event, and whether there are more.
    async fn next(&mut self) -> (Bytes, bool) {
        match self.try_next().await {
            Ok(next) => next,
            Err(error) => {
                // The work stops, if it goes on still.
                if error.stops_work() {
                    self.presence = None;
                }
                self.answered();
                let event = ErrorEvent::new(&error, &self.request_id);
                let json = serde_json::to_vec(&event).unwrap_or_default();
                (self.writer.event("error", &json), false)
            }
        }
    }

    async fn try_next(&mut self) -> Result<(Bytes, bool), ServerError> {
        loop {
            let state = Arc::clone(&self.state);
            let event = tokio::select! {
                event = self.events.recv() => event,
                () = tokio::time::sleep_until(self.until) => return Err(state.timeout()),
                () = state.lifecycle.aborted() => return Err(state.draining()),
            };
            match event {
                Some(Event::Frames(motion)) => {
                    let part = self
                        .finish(move |finisher| finisher.push(motion.view()))
                        .await?;
                    if let Some(event) = self.frames(&part)? {
                        return Ok((event, true));
                    }
                }
                Some(Event::Ended(ended)) => return self.end((*ended)?).await,
                Some(Event::Opened(_)) => {}
                None => return Err(ServerError::Internal("a dance did not end".to_owned())),
            }
        }
    }

    /// The last frames and the end of the dance, in one piece: they are few.
    async fn end(&mut self, ending: Ending) -> Result<(Bytes, bool), ServerError> {
        let part = self.finish(Finisher::end).await?;
        let mut last = self.frames(&part)?.map_or_else(Vec::new, Vec::from);
        let mut timings = ending.timings;
        timings.queue += self.waited;
        let done = done_event(self.sent, &ending.codes, &ending.tail, timings);
        last.extend(self.writer.event("done", &done.map_err(of_format)?));
        self.answered();
        Ok((last.into(), false))
    }

    /// Runs on a blocking thread: rotations and the floor of a few seconds.
    async fn finish(
        &mut self,
        work: impl FnOnce(&mut Finisher) -> Result<Finished, crate::motion::MotionError>
        + Send
        + 'static,
    ) -> Result<Finished, ServerError> {
        let gone = || ServerError::Internal("a dance was finished twice".to_owned());
        let mut finisher = self.finisher.take().ok_or_else(gone)?;
        let finished = tokio::task::spawn_blocking(move || {
            let part = work(&mut finisher);
            (finisher, part)
        })
        .await;
        let (finisher, part) = finished.map_err(|failed| {
            self.state.metrics.panicked("motion");
            ServerError::Internal(failed.to_string())
        })?;
        self.finisher = Some(finisher);
        part.map_err(|error| ServerError::Dance(error.into()))
    }

    fn frames(&mut self, part: &Finished) -> Result<Option<Bytes>, ServerError> {
        let count = part.animation.root.len();
        if count == 0 {
            return Ok(None);
        }
        let json = frames_event(part, self.sent, &self.json).map_err(of_format)?;
        self.sent += count;
        Ok(Some(self.writer.event("frames", &json)))
    }

    fn answered(&mut self) {
        if let Some(presence) = self.presence.take() {
            presence.answered();
        }
    }
}
