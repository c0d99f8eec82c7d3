//! `POST /generate`: audio in, dance out.

use std::{ops::Range, sync::Arc};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, header},
    response::{IntoResponse, Response},
};

use crate::{
    formats::{GeneratedMotion, OutputFormat, Timings},
    server::{
        error::ServerError,
        intake::{self, Purpose},
        layers::envelope::{Held, time_header},
        options::RequestOptions,
        resources::Permit,
        response::{
            answer::Written,
            documented::{FileResponse, GenerationErrors, MotionResponse},
            encoding, paced, warnings,
        },
        rig::RigAnswer,
        state::SharedState,
        upload::body::IncomingBody,
        work,
    },
};

/// Generates a dance to a song.
///
/// Send the song as part `file` of a form (the other parts are the options), or as the body itself
/// with the options in the query. A part `rig` with a character of your own (.bvh, .glb, .vrm)
/// brings the dance back as the same file, on its own bones.
#[utoipa::path(
    post,
    path = "/generate",
    operation_id = "generate_motion",
    tag = "dance",
    params(RequestOptions),
    responses(MotionResponse, GenerationErrors,)
)]
pub(crate) async fn generate(
    State(state): State<SharedState>,
    request: Request,
) -> Result<Response, ServerError> {
    answer(&state, Purpose::Dance, request).await
}

/// Generates a dance to a song, as a file.
///
/// The same as `POST /generate` for every format but JSON, BVH if none is named: a route of its own
/// for clients that are made of this document, many of which know one type of a response.
#[utoipa::path(
    post,
    path = "/generate/file",
    operation_id = "generate_file",
    tag = "dance",
    params(RequestOptions),
    responses(FileResponse, GenerationErrors,)
)]
pub(crate) async fn generate_file(
    State(state): State<SharedState>,
    request: Request,
) -> Result<Response, ServerError> {
    answer(&state, Purpose::File, request).await
}

async fn answer(
    state: &SharedState,
    purpose: Purpose,
    request: Request,
) -> Result<Response, ServerError> {
    let (parts, body) = request.into_parts();
    let body = IncomingBody::new(body);
    let under_way = state.lifecycle.enter().ok_or_else(|| state.draining())?;
    let rendered = state.in_time(render(state, purpose, parts, body)).await?;
    Ok(rendered.respond(state, None, under_way, || {}))
}

async fn render(
    state: &SharedState,
    purpose: Purpose,
    parts: axum::http::request::Parts,
    body: IncomingBody,
) -> Result<Rendered, ServerError> {
    let mut order = intake::receive(state, purpose, parts, body).await?;
    let made = async {
        let (dance, work) = work::dance_in_turn(state, &mut order, "generate").await?;
        let dance = Arc::new(dance);
        let (shape, held) = (order.shape, (&*state.resources, &state.metrics));
        let (client, options) = (order.client, &order.options);
        let writing = (Some(Arc::clone(&work)), Arc::clone(&dance));
        // Slow readers hold memory: the permit is free only once there is some.
        let written = match &order.rig {
            None => Written::new(held, client, writing.0, writing.1, options, shape).await?,
            Some(rig) => {
                let planted = options.plants_feet();
                let rig = (Arc::clone(&rig.character), planted, shape.encoding);
                Written::on_rig(held, client, writing.0, writing.1, rig).await?
            }
        };
        work.end().into_iter().for_each(Permit::complete);
        let rig = order.rig.as_ref().map(|rig| RigAnswer::of(&rig.character));
        let described = Described { rig, ..Described::new(&dance, shape.format) };
        Ok(Rendered::new(described, written))
    }
    .await;
    order.waiting.answered();
    made
}

/// What the headers say of a dance.
pub(crate) struct Described {
    pub(crate) format: OutputFormat,
    /// Of a dance on a character of the caller's own.
    pub(crate) rig: Option<RigAnswer>,
    pub(crate) seed: u64,
    pub(crate) tail: Option<String>,
    pub(crate) timings: Timings,
    pub(crate) warnings: Vec<String>,
}

impl Described {
    fn new(dance: &GeneratedMotion, format: OutputFormat) -> Self {
        Self {
            format,
            rig: None,
            seed: dance.seed,
            tail: dance.continuation.as_ref().map(crate::formats::Continuation::to_text),
            timings: dance.timings,
            warnings: dance.warnings.clone(),
        }
    }

    pub(crate) fn headers(self) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(self.format.content_type()));
        headers.insert(SEED, HeaderValue::from(self.seed));
        if let Some(tail) = self.tail.and_then(|tail| HeaderValue::try_from(tail).ok()) {
            headers.insert(TAIL, tail);
        }
        times(&mut headers, &self.timings);
        warnings::append(&mut headers, &self.warnings);
        if self.format != OutputFormat::Json {
            let extension = self.rig.as_ref().map_or(self.format.name(), RigAnswer::extension);
            let seed = self.seed;
            let name = format!("attachment; filename=\"dance-{seed}.{extension}\"");
            if let Ok(name) = HeaderValue::try_from(name) {
                headers.insert(header::CONTENT_DISPOSITION, name);
            }
        }
        if let Some(rig) = &self.rig {
            rig.add_to(&mut headers);
        }
        headers
    }
}

/// What is left of a dance once it has been written.
pub(crate) struct Rendered {
    described: Described,
    written: Arc<Written>,
}

impl Rendered {
    pub(crate) fn new(described: Described, written: Arc<Written>) -> Self {
        Self { described, written }
    }

    /// The answer, or a `part` of it; `under_way` counts it as a request until it has been sent.
    /// `taken` is called when its last part is.
    pub(crate) fn respond(
        self,
        state: &SharedState,
        part: Option<Range<u64>>,
        under_way: impl Send + 'static,
        taken: impl FnOnce() + Send + 'static,
    ) -> Response {
        let mut bytes = self.written.bytes();
        if let Some(part) = part {
            let within = |end: u64| usize::try_from(end).unwrap_or(usize::MAX).min(bytes.len());
            bytes = bytes.slice(within(part.start)..within(part.end));
        }
        let mut headers = self.described.headers();
        encoding::note(&mut headers, self.written.encoding());
        headers.insert(header::CONTENT_LENGTH, HeaderValue::from(bytes.len()));
        let body = paced::from_bytes(bytes, under_way, state.pace(), taken);
        let mut response = (Held::Paced, headers, body).into_response();
        response.extensions_mut().insert(self.written.encoding());
        response
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
