//! Responses that several routes have, as the OpenAPI document shows them.

use std::collections::BTreeMap;

use utoipa::{
    IntoResponses, ToSchema,
    openapi::{
        Content, ContentBuilder, Header, Ref, RefOr, Response, ResponseBuilder,
        header::HeaderBuilder,
        schema::{KnownFormat, ObjectBuilder, SchemaFormat, Type},
    },
};

use crate::{
    formats::{MotionJson, OutputFormat},
    server::error::ErrorBody,
};

/// What each status means, on every route.
fn about(status: u16) -> &'static str {
    match status {
        400 => "An option, a code or the form is wrong, or there is no audio.",
        401 => "An API key is required, or the one that was sent is unknown.",
        404 => "There is no such job.",
        406 => "The Accept header names no format of ours.",
        408 => "The body was not sent in time.",
        409 => "The job is not done.",
        410 => "The job expired before it began, or its files are gone from the store.",
        413 => "The audio file or the rig is too large.",
        416 => "The result has no such bytes.",
        415 => "The body is no audio that is accepted, or compressed.",
        422 => {
            "The audio cannot be decoded, or is too short or too long, or the rig is unusable, or \
             the Idempotency-Key came with another request."
        }
        429 => {
            "Too many requests are waiting, too many jobs are kept, too much is being uploaded, \
             this client calls too often or leaves too much unread: `error_type` says which."
        }
        500 => "The server is at fault.",
        _ => {
            "The model is being loaded or has stopped, the server is shutting down, there was no \
             result in time, unread responses leave no memory, or jobs cannot be kept or found: \
             `error_type` says which."
        }
    }
}

fn error(status: u16) -> Response {
    let response = ResponseBuilder::new()
        .description(about(status))
        .content("application/json", reference(&ErrorBody::name()));
    match status {
        429 | 503 => {
            response.header("retry-after", header(Type::Integer, "Seconds to wait.")).build()
        }
        _ => response.build(),
    }
}

fn reference(schema: &str) -> Content {
    let schema = Ref::from_schema_name(schema);
    ContentBuilder::new().schema(Some(schema)).build()
}

fn text() -> Content {
    let schema = ObjectBuilder::new().schema_type(Type::String);
    ContentBuilder::new().schema(Some(schema)).build()
}

fn binary() -> Content {
    let schema = ObjectBuilder::new()
        .schema_type(Type::String)
        .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)));
    ContentBuilder::new().schema(Some(schema.build())).build()
}

fn header(kind: Type, about: &str) -> Header {
    let minimum = matches!(kind, Type::Integer).then_some(0);
    let schema = ObjectBuilder::new().schema_type(kind).minimum(minimum);
    HeaderBuilder::new().schema(Some(schema)).description(Some(about)).build()
}

/// Headers of a result; those of a stream come first.
const HEADERS: [(&str, Type, &str); 10] = [
    ("x-seed", INTEGER, "The seed of the generation."),
    ("x-queue-time", NUMBER, "Milliseconds until a worker is free."),
    ("x-decode-time", NUMBER, "Milliseconds of decoding the audio."),
    ("x-feature-time", NUMBER, "Milliseconds of music features."),
    ("x-warnings", TEXT, WARNINGS),
    ("x-request-id", TEXT, "The id of the request."),
    ("x-tail", TEXT, TAIL),
    ("x-total-time", NUMBER, "Milliseconds in all."),
    ("x-inference-time", NUMBER, "Milliseconds in the model."),
    ("x-rig-mapping", TEXT, MAPPING),
];
const MAPPING: &str = "With a `rig`: JSON that says which of its bones were taken for which parts \
    of the body, and how they were found; `rig_mapping` takes it. Absent beyond 4 kB.";
const WARNINGS: &str = "What the caller should know about the result, for example that the file \
    ended early. One header for each warning, up to 8, in plain ASCII of up to 200 characters; \
    absent without warnings. The JSON carries the same texts in full as `warnings`.";
const TAIL: &str = "The option `continue_from` of a generation that continues this one; the JSON \
    carries it as `tail`.";
const INTEGER: Type = Type::Integer;
const NUMBER: Type = Type::Number;
const TEXT: Type = Type::String;
/// Those of a stream, which starts before the rest is known.
const STREAM_HEADERS: usize = 6;

fn success(
    about: &str,
    headers: usize,
    contents: impl IntoIterator<Item = (&'static str, Content)>,
) -> BTreeMap<String, RefOr<Response>> {
    let mut response = ResponseBuilder::new().description(about);
    for (kind, content) in contents {
        response = response.content(kind, content);
    }
    for (name, kind, about) in HEADERS.into_iter().take(headers) {
        response = response.header(name, header(kind, about));
    }
    [("200".to_owned(), response.build().into())].into()
}

/// A generated motion.
pub(crate) struct MotionResponse;

impl IntoResponses for MotionResponse {
    fn responses() -> BTreeMap<String, RefOr<Response>> {
        success("The motion.", HEADERS.len(), OutputFormat::ALL.map(content))
    }
}

/// A generated motion in a format that is no JSON.
pub(crate) struct FileResponse;

impl IntoResponses for FileResponse {
    fn responses() -> BTreeMap<String, RefOr<Response>> {
        let files = OutputFormat::ALL.into_iter().filter(|format| *format != OutputFormat::Json);
        success("The motion.", HEADERS.len(), files.map(content))
    }
}

fn content(format: OutputFormat) -> (&'static str, Content) {
    let content = match format {
        OutputFormat::Json => reference(&MotionJson::name()),
        OutputFormat::Bvh => text(),
        _ => binary(),
    };
    (format.content_type(), content)
}

/// The events of a generation.
pub(crate) struct StreamResponse;

impl IntoResponses for StreamResponse {
    fn responses() -> BTreeMap<String, RefOr<Response>> {
        let about = "Events: objects of the schemas StartEvent, FramesEvent, DoneEvent and \
                     ErrorEvent.";
        let kinds = ["text/event-stream", "application/x-ndjson"];
        success(about, STREAM_HEADERS, kinds.map(|kind| (kind, text())))
    }
}

macro_rules! errors {
    ($($(#[doc = $about:literal])+ $name:ident: $($status:literal)+;)+) => {
        $(
            $(#[doc = $about])+
            pub(crate) struct $name;

            impl IntoResponses for $name {
                fn responses() -> BTreeMap<String, RefOr<Response>> {
                    let named = |status: u16| (status.to_string(), error(status).into());
                    [$($status),+].map(named).into()
                }
            }
        )+
    };
}

errors! {
    /// Errors of a generation whose result is the response.
    GenerationErrors: 400 401 406 408 413 415 422 429 500 503;
    /// Errors of a new job.
    NewJobErrors: 400 401 408 413 415 422 429 500 503;
    /// Errors of a question about a job.
    JobErrors: 401 404 429 500 503;
    /// Errors of a list of jobs.
    JobListErrors: 400 401 429 500 503;
    /// Errors of the result of a job.
    JobResultErrors: 400 401 404 406 409 410 415 416 422 429 500 503;
    /// Errors of the codebooks.
    CodebookErrors: 401 429 503;
    /// Errors of the motion of a code pair.
    CodePoseErrors: 400 401 429 500 503;
    /// Errors of a server that is not ready.
    NotReady: 503;
}
