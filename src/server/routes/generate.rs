//! `POST /generate`: audio in, dance out.

use std::sync::Arc;

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, header},
    response::{IntoResponse, Response},
};

use crate::{
    formats::{GeneratedMotion, MotionJson, OutputFormat, Timings},
    server::{
        admission::Permit,
        body::IncomingBody,
        envelope::time_header,
        error::{ErrorBody, ServerError},
        intake::{self, Purpose},
        options::{AudioFile, GenerateForm, RequestOptions},
        outgoing,
        room::Share,
        state::SharedState,
        warnings, work,
    },
};

/// Generates a dance to a song.
///
/// Send the song as part `file` of a form (the other parts are the options), or as the body itself
/// with the options in the query.
#[utoipa::path(
    post,
    path = "/generate",
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
            description = "The dance.",
            content((MotionJson<'static> = "application/json"), (String = "application/x-bvh")),
            headers(
                ("x-seed" = u64, description = "The seed that was used."),
                ("x-tail" = String, description = "The option `continue_from` of a dance that is to go on from the end of this one; the JSON carries it as `tail`."),
                ("x-total-time" = f64, description = "Milliseconds in all."),
                ("x-queue-time" = f64, description = "Milliseconds spent waiting."),
                ("x-decode-time" = f64, description = "Milliseconds of decoding the audio."),
                ("x-feature-time" = f64, description = "Milliseconds of music features."),
                ("x-inference-time" = f64, description = "Milliseconds in the model."),
                ("x-warnings" = String, description = "What the caller should know about the dance, for example that the file ended early. One header for each warning, up to 8, in plain ASCII of up to 200 characters; absent without warnings. The JSON carries the same texts in full as `warnings`."),
                ("x-request-id" = String, description = "The request's id."),
            )
        ),
        (status = 400, description = "An option or the form is wrong, or there is no audio.", body = ErrorBody),
        (status = 401, description = "An API key is needed, or the one that was sent is not known.", body = ErrorBody),
        (status = 406, description = "The Accept header names no format of ours.", body = ErrorBody),
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
pub(crate) async fn generate(
    State(state): State<SharedState>,
    request: Request,
) -> Result<Response, ServerError> {
    let (parts, body) = request.into_parts();
    let body = IncomingBody::new(body);
    let under_way = state.lifecycle.enter().ok_or_else(|| state.draining())?;
    let rendered = state.in_time(render(&state, parts, body)).await?;
    Ok(rendered.respond(&state, under_way, || {}))
}

async fn render(
    state: &SharedState,
    parts: axum::http::request::Parts,
    body: IncomingBody,
) -> Result<Rendered, ServerError> {
    let mut order = intake::receive(state, Purpose::Dance, parts, body).await?;
    let made = async {
        let permit = state.admission.admit_traced().await?;
        let (dance, work) = work::dance(state, &mut order, permit, "generate").await?;
        let dance = Arc::new(dance);
        let (options, format) = (order.options.clone(), order.shape.format);
        let written = Arc::clone(&dance);
        let body = work::write(&state.metrics, Some(&work), written, options, format).await?;
        // Slow readers hold memory: the permit is free only once there is some.
        let room = state.room(body.len()).await?;
        work.end().into_iter().for_each(Permit::danced);
        Ok(Rendered::new(&dance, body, format, room))
    }
    .await;
    order.waiting.answered();
    made
}

/// What is left of a dance once it has been written.
pub(crate) struct Rendered {
    body: Vec<u8>,
    format: OutputFormat,
    seed: u64,
    tail: Option<String>,
    timings: Timings,
    warnings: Vec<String>,
    room: Share,
}

impl Rendered {
    pub(crate) fn new(
        dance: &GeneratedMotion,
        body: Vec<u8>,
        format: OutputFormat,
        room: Share,
    ) -> Self {
        Self {
            body,
            format,
            seed: dance.seed,
            tail: dance
                .continuation
                .as_ref()
                .map(crate::formats::Continuation::to_text),
            timings: dance.timings,
            warnings: dance.warnings.clone(),
            room,
        }
    }

    /// The answer; `under_way` counts it as a request until it has been sent.
    /// `taken` is called when its last part is.
    pub(crate) fn respond(
        self,
        state: &SharedState,
        under_way: impl Send + Sync + 'static,
        taken: impl FnOnce() + Send + 'static,
    ) -> Response {
        let mut headers = HeaderMap::new();
        headers.insert(
            header::CONTENT_TYPE,
            HeaderValue::from_static(self.format.content_type()),
        );
        headers.insert(header::CONTENT_LENGTH, HeaderValue::from(self.body.len()));
        headers.insert(SEED, HeaderValue::from(self.seed));
        if let Some(tail) = self.tail.and_then(|tail| HeaderValue::try_from(tail).ok()) {
            headers.insert(TAIL, tail);
        }
        times(&mut headers, &self.timings);
        warnings::append(&mut headers, &self.warnings);
        if self.format == OutputFormat::Bvh {
            let name = format!("attachment; filename=\"dance-{}.bvh\"", self.seed);
            if let Ok(name) = HeaderValue::try_from(name) {
                headers.insert(header::CONTENT_DISPOSITION, name);
            }
        }
        let patience = state.limits.answer_idle_timeout.0;
        let body = outgoing::whole(self.body, (under_way, self.room), patience, taken);
        (headers, body).into_response()
    }
}

/// Adds one header for each stage.
pub(crate) fn times(headers: &mut HeaderMap, timings: &Timings) {
    for (name, time) in [
        (QUEUE_TIME, timings.queue),
        (DECODE_TIME, timings.decode),
        (FEATURE_TIME, timings.features),
        (INFERENCE_TIME, timings.inference),
    ] {
        headers.insert(name, time_header(time));
    }
}

pub(crate) const SEED: HeaderName = HeaderName::from_static("x-seed");
const TAIL: HeaderName = HeaderName::from_static("x-tail");
const QUEUE_TIME: HeaderName = HeaderName::from_static("x-queue-time");
const DECODE_TIME: HeaderName = HeaderName::from_static("x-decode-time");
const FEATURE_TIME: HeaderName = HeaderName::from_static("x-feature-time");
const INFERENCE_TIME: HeaderName = HeaderName::from_static("x-inference-time");
