//! `POST /generate/stream`: a dance while it is made.

mod sender;

use std::{sync::Arc, time::Duration};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, header},
    response::{IntoResponse, Response},
};
use tokio::{sync::mpsc, time::Instant};
use tracing::Instrument;

use self::sender::{Event, Forward, Sender};
use crate::{
    engine::{Generation, Opening},
    server::{
        admission::Permit,
        body::IncomingBody,
        envelope::request_id,
        error::{ErrorBody, ServerError},
        intake::{self, Order, Purpose},
        negotiate::{EVENTS, LINES},
        options::{AudioFile, GenerateForm, RequestOptions},
        outgoing,
        room::Share,
        routes::generate::{SEED, times},
        state::SharedState,
        tracker::Work,
        warnings, work,
    },
};

/// Generates a dance and sends it while it is made.
///
/// The same input as `POST /generate`. All checks, decoding and music features happen before the answer
/// begins; then come one `start` event, `frames` events with the dance's frames in order, and one `done`
/// event, or an `error` event if something goes wrong meanwhile. Server-sent events by default; with
/// `Accept: application/x-ndjson` the same objects as lines. Frames are those of `POST /generate` with the
/// same seed, but for a few centimetres of height at most: where the floor is, is told from 2.5 s ahead.
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
            description = "The model is being loaded or has stopped, the server is shutting down, there was no result in time, or answers that nobody takes leave no room for it.",
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
    let headers = head(&opened);
    let patience = state.limits.answer_idle_timeout.0;
    let sender = Sender::new(state, request_id, opened, under_way)?;
    Ok((headers, outgoing::attended(sender.events(), patience)).into_response())
}

fn head(opened: &Opened) -> HeaderMap {
    let Opened { order, opening, .. } = opened;
    let mut headers = HeaderMap::new();
    let kind = if order.shape.lines { LINES } else { EVENTS };
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(SEED, HeaderValue::from(opening.seed));
    times(&mut headers, &opening.timings);
    headers.remove("x-inference-time");
    warnings::append(&mut headers, &opening.warnings);
    headers
}

/// A dance that has begun.
struct Opened {
    order: Order,
    opening: Opening,
    events: mpsc::UnboundedReceiver<Event>,
    room: Share,
}

async fn open(
    state: &SharedState,
    parts: axum::http::request::Parts,
    body: IncomingBody,
    until: Instant,
) -> Result<Opened, ServerError> {
    let mut order = intake::receive(state, Purpose::Stream, parts, body).await?;
    match begin(state, &mut order, until).await {
        Ok((opening, events, room)) => Ok(Opened {
            order,
            opening,
            events,
            room,
        }),
        Err(error) => {
            order.waiting.answered();
            Err(error)
        }
    }
}

/// Waits for a permit, submits the request, and waits until the engine knows what the motion will
/// be.
async fn begin(
    state: &SharedState,
    order: &mut Order,
    until: Instant,
) -> Result<(Opening, mpsc::UnboundedReceiver<Event>, Share), ServerError> {
    let permit = state.admission.admit_traced().await?;
    let waited = permit.waited;
    let (request, work) = order.begin(state, permit).await?;
    let room = state.room(most_bytes(state, order)).await?;
    let (sender, mut events) = mpsc::unbounded_channel();
    let stream = Arc::new(Forward {
        waited,
        sender: sender.clone(),
    });
    let generation = order.engine.submit(request.streamed_to(stream));
    let run = Run {
        state: Arc::clone(state),
        work,
        sender,
        until,
    };
    tokio::spawn(run.until_the_end(generation, waited).in_current_span());
    match events.recv().await {
        Some(Event::Opened(opening)) => Ok((*opening, events, room)),
        Some(Event::Ended(ended)) => Err(match *ended {
            Err(error) => error,
            Ok(_) => ServerError::Internal("a dance ended before it began".to_owned()),
        }),
        _ => Err(ServerError::Internal("a dance did not begin".to_owned())),
    }
}

/// Follows a streamed generation to its end, whether or not its events are read meanwhile.
struct Run {
    state: SharedState,
    work: Arc<Work>,
    sender: mpsc::UnboundedSender<Event>,
    until: Instant,
}

impl Run {
    /// Sends the end as the last event. A generation that is out of time, that the server gives
    /// up, or that has no reader any more, is dropped and thereby cancelled at once.
    async fn until_the_end(self, generation: Generation, waited: Duration) {
        let Self {
            state,
            work,
            sender,
            until,
        } = self;
        let finished = work::finished(&state.metrics, generation, work.tracker(), waited, "stream");
        let ended = tokio::select! {
            finished = tokio::time::timeout_at(until, finished) => match finished {
                Ok(finished) => {
                    let permit = work.end().filter(|_| finished.is_ok());
                    permit.into_iter().for_each(Permit::danced);
                    finished
                }
                Err(_) => Err(state.timeout()),
            },
            () = state.lifecycle.aborted() => Err(state.draining()),
            () = sender.closed() => return,
        };
        // The reader may have gone meanwhile.
        let _ = sender.send(Event::Ended(Box::new(ended)));
    }
}

/// Most bytes of decoded motion that may wait for a reader: all of the dance, as float32.
fn most_bytes(state: &SharedState, order: &Order) -> usize {
    let manifest = order.engine.manifest();
    let frames = order.most_seconds(&state.limits) as usize * manifest.fps as usize;
    frames * manifest.decoded_columns() * size_of::<f32>()
}
