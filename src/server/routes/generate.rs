//! `POST /generate`: audio in, dance out.

use std::sync::Arc;

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, header},
    response::{IntoResponse, Response},
};
use bytes::Bytes;

use crate::{
    CancelToken,
    format::{Dance, DanceJson, OutputFormat, Timings},
    server::{
        admission::Permit,
        body::IncomingBody,
        envelope::{panic_text, time_header},
        error::{ErrorBody, ServerError},
        media::Media,
        negotiate,
        options::{AudioFile, GenerateForm, RequestOptions},
        outgoing,
        state::{Generate, SharedState},
        upload, warnings,
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
            content((DanceJson<'static> = "application/json"), (String = "application/x-bvh")),
            headers(
                ("x-seed" = u64, description = "The seed that was used."),
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
        (status = 406, description = "The Accept header names no format of ours.", body = ErrorBody),
        (status = 408, description = "The body was not sent in time.", body = ErrorBody),
        (status = 413, description = "The audio file is too large.", body = ErrorBody),
        (status = 415, description = "The body is no audio that is accepted, or compressed.", body = ErrorBody),
        (status = 422, description = "The audio cannot be decoded, or is too short or too long.", body = ErrorBody),
        (
            status = 429,
            description = "Too many requests are waiting.",
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
    )
)]
pub(crate) async fn generate(
    State(state): State<SharedState>,
    request: Request,
) -> Result<Response, ServerError> {
    let (parts, body) = request.into_parts();
    let body = IncomingBody::new(body);
    let under_way = state.lifecycle.enter().ok_or_else(|| state.draining())?;
    let limit = state.limits.request_timeout;
    let rendered = tokio::time::timeout(limit.0, render(&state, parts, body));
    let rendered = tokio::select! {
        rendered = rendered => rendered.map_err(|_| ServerError::Timeout {
            limit,
            retry_after: state.admission.retry_after(),
        })??,
        () = state.lifecycle.aborted() => return Err(state.draining()),
    };
    Ok(rendered.respond(under_way))
}

/// Everything that costs nothing is checked first; then a permit is waited for; only then is the
/// body read (RELIABILITY, defence 2).
async fn render(
    state: &SharedState,
    parts: axum::http::request::Parts,
    body: IncomingBody,
) -> Result<Rendered, ServerError> {
    let limits = &state.limits;
    let engine = &state.loaded()?.engine;
    let media = Media::of(&parts.headers)?;
    let options = RequestOptions::from_query(&parts.uri)?;
    engine.check(&options.generation(OutputFormat::Json))?;
    upload::check_declared(&body, media, limits)?;
    let accept = parts.headers.clone();
    // Only a form may still name a format that makes its Accept header irrelevant.
    let early = match (options.format, media) {
        (Some(format), _) => Some(format),
        (None, Media::Raw) => Some(negotiate::from_accept(&accept)?),
        (None, Media::Form) => None,
    };

    let permit = state.admission.admit().await?;
    let waited = permit.waited;
    let body = body.timed(limits.body_idle_timeout.0, limits.body_timeout.0);
    let upload = upload::receive(parts, body, media, options, limits).await?;
    let format = match upload.options.format.or(early) {
        Some(format) => format,
        None => negotiate::from_accept(&accept)?,
    };
    let job = Job {
        engine: Arc::clone(engine),
        audio: upload.audio,
        options: upload.options,
        format,
        permit,
    };
    let mut rendered = job.run().await?;
    rendered.timings.queue += waited;
    Ok(rendered)
}

/// One generation with all it needs; it holds its permit until the work has really ended.
struct Job {
    engine: Arc<dyn Generate>,
    audio: Bytes,
    options: RequestOptions,
    format: OutputFormat,
    permit: Permit,
}

/// What is left of a dance once it has been written.
struct Rendered {
    body: Vec<u8>,
    format: OutputFormat,
    seed: u64,
    timings: Timings,
    warnings: Vec<String>,
}

impl Job {
    /// Runs on a blocking thread. Dropping the returned future stops the work.
    async fn run(self) -> Result<Rendered, ServerError> {
        let generation = self.options.generation(self.format);
        self.engine.check(&generation)?;
        let cancel = CancelToken::new();
        let _stop_when_nobody_waits = cancel.cancel_on_drop();
        let work = move || {
            // Named, so that the closure owns it: dropping the future alone must not free it.
            let permit = self.permit;
            let dance = self.engine.generate(self.audio, &generation, &cancel)?;
            let body = self.options.write(&dance, self.format)?;
            permit.danced();
            Ok(Rendered::new(dance, body, self.format))
        };
        match tokio::task::spawn_blocking(work).await {
            Ok(result) => result,
            Err(failed) => Err(ServerError::Internal(match failed.try_into_panic() {
                Ok(panic) => format!("panic: {}", panic_text(panic.as_ref())),
                Err(failed) => failed.to_string(),
            })),
        }
    }
}

impl Rendered {
    fn new(dance: Dance, body: Vec<u8>, format: OutputFormat) -> Self {
        Self {
            body,
            format,
            seed: dance.seed,
            timings: dance.timings,
            warnings: dance.warnings,
        }
    }

    /// The answer; `under_way` counts it as a request until it has been sent.
    fn respond(self, under_way: impl Send + 'static) -> Response {
        let timings = self.timings;
        let mut headers = HeaderMap::new();
        headers.insert(
            header::CONTENT_TYPE,
            HeaderValue::from_static(self.format.content_type()),
        );
        headers.insert(header::CONTENT_LENGTH, HeaderValue::from(self.body.len()));
        headers.insert(SEED, HeaderValue::from(self.seed));
        for (name, time) in [
            (QUEUE_TIME, timings.queue),
            (DECODE_TIME, timings.decode),
            (FEATURE_TIME, timings.features),
            (INFERENCE_TIME, timings.inference),
        ] {
            headers.insert(name, time_header(time));
        }
        warnings::append(&mut headers, &self.warnings);
        if self.format == OutputFormat::Bvh {
            let name = format!("attachment; filename=\"dance-{}.bvh\"", self.seed);
            if let Ok(name) = HeaderValue::try_from(name) {
                headers.insert(header::CONTENT_DISPOSITION, name);
            }
        }
        (headers, outgoing::guarded(self.body, under_way)).into_response()
    }
}

const SEED: HeaderName = HeaderName::from_static("x-seed");
const QUEUE_TIME: HeaderName = HeaderName::from_static("x-queue-time");
const DECODE_TIME: HeaderName = HeaderName::from_static("x-decode-time");
const FEATURE_TIME: HeaderName = HeaderName::from_static("x-feature-time");
const INFERENCE_TIME: HeaderName = HeaderName::from_static("x-inference-time");
