//! `POST /generate/stream`: a dance while it is made.

mod opened;
mod sender;

use std::{sync::Arc, time::Duration};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, header},
    response::{IntoResponse, Response},
};
use tokio::{sync::mpsc, time::Instant};
use tracing::Instrument;

use self::{
    opened::{Event, Forward, Opened},
    sender::Sender,
};
use crate::{
    engine::{Generation, Opening},
    server::{
        error::ServerError,
        intake::{self, Order, Purpose},
        layers::envelope::{Held, request_id},
        options::RequestOptions,
        resources::{Permit, Reservation, Stay},
        response::{
            documented::{GenerationErrors, StreamResponse},
            negotiate::{EVENTS, LINES},
            paced, warnings,
        },
        routes::generate::{SEED, times},
        state::SharedState,
        tracker::Work,
        upload::body::IncomingBody,
        work,
    },
};

/// Generates a dance and sends it while it is made.
///
/// The same input as `POST /generate`. All checks, decoding and music features happen before the
/// answer begins; then come one `start` event, `frames` events with the dance's frames in order,
/// and one `done` event, or an `error` event if something goes wrong meanwhile. Server-sent events
/// by default; with `Accept: application/x-ndjson` the same objects as lines. Frames are those of
/// `POST /generate` with the same seed, but for a few centimetres of height at most: where the
/// floor is, is told from 2.5 s ahead.
#[utoipa::path(
    post,
    path = "/generate/stream",
    operation_id = "stream_motion",
    tag = "dance",
    params(RequestOptions),
    responses(StreamResponse, GenerationErrors,)
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
    let pace = state.pace();
    let sender = Sender::new(state, request_id, opened, under_way)?;
    Ok((Held::Paced, headers, paced::from_stream(sender.events(), pace)).into_response())
}

fn head(opened: &Opened) -> HeaderMap {
    let Opened { order, opening, .. } = opened;
    let mut headers = HeaderMap::new();
    let kind = if order.shape.lines { LINES } else { EVENTS };
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    unbuffered(&mut headers);
    headers.insert(SEED, HeaderValue::from(opening.seed));
    times(&mut headers, &opening.timings);
    headers.remove("x-inference-time");
    warnings::append(&mut headers, &opening.warnings);
    headers
}

/// Asks proxies to pass events on as they come: nginx collects them otherwise, and others wait for
/// enough to compress.
pub(crate) fn unbuffered(headers: &mut HeaderMap) {
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store, no-transform"));
    headers.insert("x-accel-buffering", HeaderValue::from_static("no"));
}

async fn open(
    state: &SharedState,
    parts: axum::http::request::Parts,
    body: IncomingBody,
    until: Instant,
) -> Result<Opened, ServerError> {
    let mut order = intake::receive(state, Purpose::Stream, parts, body).await?;
    match begin(state, &mut order, until).await {
        Ok((opening, events, room)) => Ok(Opened { order, opening, events, room }),
        Err(error) => {
            order.waiting.answered();
            Err(error)
        }
    }
}

/// A stream that has begun: what the motion will be, its events, and room for them.
type Begun = (Opening, mpsc::UnboundedReceiver<Event>, Reservation);

/// Waits for a permit and begins.
async fn begin(
    state: &SharedState,
    order: &mut Order,
    until: Instant,
) -> Result<Begun, ServerError> {
    let permit = order.admit(state, Stay::Short).await?;
    let is_express = permit.is_express();
    match begin_with(state, order, permit, until).await {
        Err(error) if is_express && error.is_too_long() => {
            let permit = order.admit(state, Stay::Long).await?;
            begin_with(state, order, permit, until).await
        }
        other => other,
    }
}

/// Submits the request, and waits until the engine knows what the motion will be.
async fn begin_with(
    state: &SharedState,
    order: &mut Order,
    permit: Permit,
    until: Instant,
) -> Result<Begun, ServerError> {
    let waited = permit.waited;
    let most = order.most_seconds(&state.limits, permit.is_express());
    let (request, work) = order.begin(state, permit).await?;
    let fps = order.engine.manifest().fps as usize;
    let most = bytes_of(order, most as usize * fps);
    let mut room = state.resources.reserve_response(order.client, most).await?;
    let (sender, mut events) = mpsc::unbounded_channel();
    let stream = Arc::new(Forward { waited, sender: sender.clone() });
    let generation = order.engine.submit(request.streamed_to(stream));
    let run = Run { state: Arc::clone(state), work, sender, until };
    tokio::spawn(run.until_the_end(generation, waited).in_current_span());
    match events.recv().await {
        Some(Event::Opened(opening)) => {
            // The song is known now, and mostly shorter than the longest.
            let seconds = opening.frames.div_ceil(opening.fps as usize);
            room.shrink_to(bytes_of(order, seconds * fps) as u64);
            Ok((*opening, events, room))
        }
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
        let Self { state, work, sender, until } = self;
        let finished = work::finished(&state.metrics, generation, work.tracker(), waited, "stream");
        let ended = tokio::select! {
            finished = tokio::time::timeout_at(until, finished) => match finished {
                Ok(finished) => {
                    let permit = work.end().filter(|_| finished.is_ok());
                    permit.into_iter().for_each(Permit::complete);
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

/// Bytes of decoded motion, which may wait for a reader: all of the dance, as float32.
fn bytes_of(order: &Order, frames: usize) -> usize {
    frames * order.engine.manifest().decoded_columns() * size_of::<f32>()
}
