//! What a caller is told when something is wrong: the one place where errors become a status and
//! an `error_type`.

use axum::{
    body::Body,
    http::{HeaderValue, Response, StatusCode, header},
    response::IntoResponse,
};
use serde::Serialize;
use tokio::sync::AcquireError;
use utoipa::ToSchema;

use super::config::{ByteSize, Seconds};
use crate::{audio::AudioError, engine::EngineError, features::FeatureError, formats::FormatError};

/// The body of every answer that is not a success.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct ErrorBody {
    /// What was wrong and what is accepted.
    #[schema(example = "option `fps`: got \"25\", expected one of 20, 24, 30, 60")]
    pub error: String,
    /// Kind of error, for programs.
    #[schema(example = "invalid_option")]
    pub error_type: String,
    /// The same as the header `x-request-id`; name it when you report a problem.
    pub request_id: String,
}

/// Last event of a stream that went wrong.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(crate) struct ErrorEvent {
    /// `error`.
    event: &'static str,
    #[serde(flatten)]
    body: ErrorBody,
}

impl ErrorEvent {
    pub(crate) fn new(report: &Report, request_id: &str) -> Self {
        Self {
            event: "error",
            body: report.body(request_id),
        }
    }
}

/// Anything that keeps a request from its result.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ServerError {
    #[error("option `{name}`: {problem}")]
    Option { name: String, problem: String },
    #[error("{0}")]
    Multipart(String),
    #[error(
        "no audio was sent: send a file as part `file` of multipart/form-data, or as the body itself with content type audio/*"
    )]
    MissingAudio,
    #[error("there is nothing at {path}: GET /docs lists what there is")]
    NotFound { path: String },
    #[error("{path} does not answer to {method}: GET /docs lists what it answers to")]
    MethodNotAllowed { path: String, method: String },
    #[error("the Accept header asks for {asked:?}, which is not available: expected {available}")]
    NotAcceptable { asked: String, available: String },
    #[error(
        "the body was not sent in time: {idle} s without data and {total} s in all are allowed"
    )]
    UploadTimeout { idle: Seconds, total: Seconds },
    #[error("the upload broke off before its end")]
    UploadBroken,
    #[error(
        "the audio is larger than {limit}: up to {lossy} is accepted, up to {lossless} for wav and flac"
    )]
    TooLarge {
        limit: ByteSize,
        lossy: ByteSize,
        lossless: ByteSize,
    },
    #[error("{0}")]
    UnsupportedMedia(String),
    #[error("{queue} requests are waiting already: try again in {} s", retry_after.retry_after())]
    QueueFull { queue: usize, retry_after: Seconds },
    #[error("{most} uploads are on their way already: try again in {} s", retry_after.retry_after())]
    TooManyUploads { most: usize, retry_after: Seconds },
    #[error("uploads take all of the {memory} that the server holds for them: try again in {} s", retry_after.retry_after())]
    UploadMemory {
        memory: ByteSize,
        retry_after: Seconds,
    },
    #[error("answers take all of the {memory} that the server holds for their readers: try again in {} s", retry_after.retry_after())]
    AnswerMemory {
        memory: ByteSize,
        retry_after: Seconds,
    },
    #[error("you have made more requests than the {per_minute} a minute that are allowed: try again in {} s", retry_after.retry_after())]
    RateLimited {
        per_minute: u32,
        retry_after: Seconds,
    },
    #[error("{most} jobs are kept already: fetch and delete finished ones, or try again in {} s", retry_after.retry_after())]
    TooManyJobs { most: usize, retry_after: Seconds },
    #[error("an API key is needed: send it as `Authorization: Bearer KEY` or `X-API-Key: KEY`")]
    KeyMissing,
    #[error("this API key is not known here")]
    KeyWrong,
    #[error("there is no job {id}: it was deleted, has expired, or never was")]
    NoJob { id: String },
    #[error("job {id} is not done: it is {state}")]
    JobNotDone { id: String, state: &'static str },
    #[error("the server is shutting down: try again in {} s", retry_after.retry_after())]
    Draining { retry_after: Seconds },
    #[error("the model is being loaded: try again in {} s", retry_after.retry_after())]
    Loading { retry_after: Seconds },
    #[error("the model has stopped: the server must be started again")]
    ModelStopped,
    #[error("there was no result within {limit} s: try again in {} s, or send a shorter part", retry_after.retry_after())]
    Timeout {
        limit: Seconds,
        retry_after: Seconds,
    },
    #[error("the server failed: {0}")]
    Internal(String),
    #[error(transparent)]
    Engine(EngineError),
    #[error(transparent)]
    Format(#[from] FormatError),
}

impl From<EngineError> for ServerError {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Stopped => Self::ModelStopped,
            other => Self::Engine(other),
        }
    }
}

/// No semaphore of ours is ever closed.
impl From<AcquireError> for ServerError {
    fn from(closed: AcquireError) -> Self {
        Self::Internal(closed.to_string())
    }
}

/// Leaves with the response; the outermost layer, which knows the request's id, makes an
/// [`ErrorBody`] of it.
#[derive(Clone, Debug)]
pub(crate) struct Report {
    pub(crate) status: StatusCode,
    pub(crate) message: String,
    pub(crate) error_type: &'static str,
    retry_after: Option<u64>,
    /// Was counted before.
    pub(crate) repeated: bool,
}

impl Report {
    /// What was told before about the request of another id.
    pub(crate) fn repeated(mut self, request_id: &str) -> Self {
        self.message = format!("{} (of the request {request_id})", self.message);
        self.repeated = true;
        self
    }

    /// The body of an answer, or of a part of one.
    pub(crate) fn body(&self, request_id: &str) -> ErrorBody {
        ErrorBody {
            error: self.message.clone(),
            error_type: self.error_type.to_owned(),
            request_id: request_id.to_owned(),
        }
    }
}

impl ServerError {
    fn classify(&self) -> (StatusCode, &'static str) {
        match self {
            Self::Option { .. } => (StatusCode::BAD_REQUEST, "invalid_option"),
            Self::Multipart(_) => (StatusCode::BAD_REQUEST, "invalid_multipart"),
            Self::MissingAudio => (StatusCode::BAD_REQUEST, "missing_audio"),
            Self::UploadBroken => (StatusCode::BAD_REQUEST, "upload_broken"),
            Self::NotFound { .. } => (StatusCode::NOT_FOUND, "not_found"),
            Self::MethodNotAllowed { .. } => (StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed"),
            Self::NotAcceptable { .. } => (StatusCode::NOT_ACCEPTABLE, "not_acceptable"),
            Self::UploadTimeout { .. } => (StatusCode::REQUEST_TIMEOUT, "upload_timeout"),
            Self::TooLarge { .. } => (StatusCode::PAYLOAD_TOO_LARGE, "payload_too_large"),
            Self::UnsupportedMedia(_) => {
                (StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type")
            }
            Self::QueueFull { .. } => (StatusCode::TOO_MANY_REQUESTS, "queue_full"),
            Self::TooManyUploads { .. } => (StatusCode::TOO_MANY_REQUESTS, "too_many_uploads"),
            Self::UploadMemory { .. } => (StatusCode::TOO_MANY_REQUESTS, "upload_memory"),
            Self::RateLimited { .. } => (StatusCode::TOO_MANY_REQUESTS, "rate_limited"),
            Self::TooManyJobs { .. } => (StatusCode::TOO_MANY_REQUESTS, "too_many_jobs"),
            Self::KeyMissing => (StatusCode::UNAUTHORIZED, "missing_api_key"),
            Self::KeyWrong => (StatusCode::UNAUTHORIZED, "wrong_api_key"),
            Self::NoJob { .. } => (StatusCode::NOT_FOUND, "no_such_job"),
            Self::JobNotDone { .. } => (StatusCode::CONFLICT, "job_not_done"),
            Self::Draining { .. } => (StatusCode::SERVICE_UNAVAILABLE, "draining"),
            Self::Loading { .. } => (StatusCode::SERVICE_UNAVAILABLE, "loading"),
            Self::ModelStopped => (StatusCode::SERVICE_UNAVAILABLE, "model_stopped"),
            Self::Timeout { .. } => (StatusCode::SERVICE_UNAVAILABLE, "timeout"),
            Self::AnswerMemory { .. } => (StatusCode::SERVICE_UNAVAILABLE, "answer_memory"),
            Self::Internal(_) => (StatusCode::INTERNAL_SERVER_ERROR, "internal"),
            Self::Format(_) => (StatusCode::INTERNAL_SERVER_ERROR, "internal"),
            Self::Engine(error) => classify_generation(error),
        }
    }

    fn retry_after(&self) -> Option<Seconds> {
        match self {
            Self::QueueFull { retry_after, .. }
            | Self::TooManyUploads { retry_after, .. }
            | Self::UploadMemory { retry_after, .. }
            | Self::AnswerMemory { retry_after, .. }
            | Self::RateLimited { retry_after, .. }
            | Self::TooManyJobs { retry_after, .. }
            | Self::Draining { retry_after }
            | Self::Loading { retry_after }
            | Self::Timeout { retry_after, .. } => Some(*retry_after),
            // Whoever restarts a server that is not ready needs about that long.
            Self::ModelStopped => Some(Seconds::new(30)),
            // The model's own queue is as long as there are permits, so this is next to impossible;
            // its places are given back at the pace of one step of the model.
            // A thread is free again as soon as another song has been decoded.
            Self::Engine(
                EngineError::QueueFull { .. }
                | EngineError::NoThread(_)
                | EngineError::Audio(AudioError::NoThread(_)),
            ) => Some(Seconds::new(1)),
            _ => None,
        }
    }
}

fn classify_generation(error: &EngineError) -> (StatusCode, &'static str) {
    const INTERNAL: (StatusCode, &str) = (StatusCode::INTERNAL_SERVER_ERROR, "internal");
    match error {
        EngineError::Audio(error) => classify_audio(error),
        EngineError::Features(FeatureError::TooShort { .. }) => {
            (StatusCode::UNPROCESSABLE_ENTITY, "audio_too_short")
        }
        EngineError::Features(FeatureError::NotFinite { .. }) => {
            (StatusCode::UNPROCESSABLE_ENTITY, "undecodable_audio")
        }
        // Features come from the upload alone here, so a problem with them is ours.
        EngineError::Option { name, .. } if *name != "features" => {
            (StatusCode::BAD_REQUEST, "invalid_option")
        }
        EngineError::QueueFull { .. } => (StatusCode::TOO_MANY_REQUESTS, "queue_full"),
        EngineError::NoThread(_) => (StatusCode::SERVICE_UNAVAILABLE, "no_thread"),
        _ => INTERNAL,
    }
}

fn classify_audio(error: &AudioError) -> (StatusCode, &'static str) {
    const UNPROCESSABLE: StatusCode = StatusCode::UNPROCESSABLE_ENTITY;
    match error {
        AudioError::Empty => (StatusCode::BAD_REQUEST, "missing_audio"),
        AudioError::UnsupportedContainer { .. } | AudioError::UnsupportedCodec { .. } => {
            (StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type")
        }
        AudioError::TooShort { .. } => (UNPROCESSABLE, "audio_too_short"),
        AudioError::TooLong { .. } => (UNPROCESSABLE, "audio_too_long"),
        AudioError::RangeOutside { .. } | AudioError::InvalidRange { .. } => {
            (StatusCode::BAD_REQUEST, "invalid_option")
        }
        AudioError::Malformed { .. }
        | AudioError::SampleRate { .. }
        | AudioError::Channels { .. }
        | AudioError::DecodeTimeout { .. }
        | AudioError::DecoderPanic { .. } => (UNPROCESSABLE, "undecodable_audio"),
        AudioError::NoThread(_) => (StatusCode::SERVICE_UNAVAILABLE, "no_thread"),
        AudioError::Cancelled | AudioError::OutputRate { .. } => {
            (StatusCode::INTERNAL_SERVER_ERROR, "internal")
        }
    }
}

impl ServerError {
    /// What a caller is told. Faults of our own are logged here, and not told.
    pub(crate) fn report(&self) -> Report {
        let (status, error_type) = self.classify();
        let message = if status == StatusCode::INTERNAL_SERVER_ERROR {
            tracing::error!(error = %self, "request failed");
            "something went wrong inside the server: report it with the request_id".to_owned()
        } else {
            self.to_string()
        };
        Report {
            status,
            message,
            error_type,
            retry_after: self.retry_after().map(Seconds::retry_after),
            repeated: false,
        }
    }

    /// Whether the work itself did not end, so that it must be stopped.
    pub(crate) fn stops_work(&self) -> bool {
        matches!(self, Self::Timeout { .. } | Self::Draining { .. })
    }
}

impl IntoResponse for ServerError {
    fn into_response(self) -> Response<Body> {
        let mut response = self.report().into_response();
        if response.status() == StatusCode::UNAUTHORIZED {
            let scheme = HeaderValue::from_static("Bearer");
            response
                .headers_mut()
                .insert(header::WWW_AUTHENTICATE, scheme);
        }
        response
    }
}

impl IntoResponse for Report {
    fn into_response(self) -> Response<Body> {
        let mut response = Response::new(Body::empty());
        *response.status_mut() = self.status;
        if let Some(seconds) = self.retry_after {
            response
                .headers_mut()
                .insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response.extensions_mut().insert(self);
        response
    }
}

/// Writes the body of an error answer. One that did not come from [`ServerError`] (the router's own,
/// or a layer's) keeps its status and gets the message that fits it.
pub(crate) fn write_body(response: Response<Body>, request_id: &str) -> Response<Body> {
    let (mut parts, _) = response.into_parts();
    let report = parts
        .extensions
        .remove::<Report>()
        .unwrap_or_else(|| Report {
            status: parts.status,
            retry_after: None,
            repeated: false,
            message: parts
                .status
                .canonical_reason()
                .unwrap_or("the request cannot be answered")
                .to_lowercase(),
            error_type: match parts.status {
                StatusCode::NOT_FOUND => "not_found",
                status if status.is_server_error() => "internal",
                _ => "invalid_request",
            },
        });
    let body = serde_json::json!(report.body(request_id)).to_string();
    parts.headers.remove(header::CONTENT_LENGTH);
    parts.headers.insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("application/json"),
    );
    Response::from_parts(parts, Body::from(body))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_that_stops_meanwhile_is_told_as_the_probe_tells_it() {
        let stopped = ServerError::from(EngineError::Stopped).report();
        let probed = ServerError::ModelStopped.report();
        assert_eq!(
            (stopped.status, stopped.error_type, stopped.retry_after),
            (
                StatusCode::SERVICE_UNAVAILABLE,
                "model_stopped",
                probed.retry_after
            )
        );
        assert!(stopped.retry_after.is_some());
    }
}
