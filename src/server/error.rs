//! Errors as callers see them: the one place where they become a status and an `error_type`.

use std::borrow::Cow;

use axum::{
    body::Body,
    http::{HeaderValue, Response, StatusCode, header},
    response::IntoResponse,
};
use serde::Serialize;
use utoipa::ToSchema;

use super::config::{ByteSize, Seconds};
use crate::{
    audio::AudioError, engine::EngineError, features::FeatureError, formats::FormatError,
    options::OptionError,
};

/// The body of every response that is not a success.
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

/// Last event of a stream that failed.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(crate) struct ErrorEvent {
    /// `error`.
    event: &'static str,
    #[serde(flatten)]
    body: ErrorBody,
}

impl ErrorEvent {
    pub(crate) fn new(report: &Report, request_id: &str) -> Self {
        Self { event: "error", body: report.body(request_id) }
    }
}

/// Defines the errors: status, `error_type`, name and values, message. The first block holds those
/// that a later attempt may not meet, with the time to wait.
macro_rules! errors {
    (
        retry { $(
            $busy_status:ident $busy_kind:literal $busy:ident { $($value:ident: $value_type:ty),+ }
                => $busy_message:literal $(, $busy_argument:expr)?;
        )+ }
        refuse { $(
            $status:ident $kind:literal $name:ident
                $({ $($field:ident: $type:ty),+ })? $(($inner:ty))?
                => $message:literal;
        )+ }
    ) => {
        /// The reason why a request has no result.
        #[derive(Debug, thiserror::Error)]
        pub(crate) enum ServerError {
            $(
                #[error($busy_message $(, $busy_argument)?)]
                $busy { $($value: $value_type),+ },
            )+
            $(
                #[error($message)]
                $name $({ $($field: $type),+ })? $(($inner))?,
            )+
            #[error(transparent)]
            Engine(EngineError),
            #[error(transparent)]
            Format(#[from] FormatError),
        }

        impl ServerError {
            fn classify(&self) -> (StatusCode, &'static str) {
                match self {
                    $(Self::$busy { .. } => (StatusCode::$busy_status, $busy_kind),)+
                    $(Self::$name { .. } => (StatusCode::$status, $kind),)+
                    Self::Engine(error) => classify_generation(error),
                    // The model's joints are not those that this format or skeleton needs.
                    Self::Format(
                        FormatError::Skeleton { .. }
                        | FormatError::NoBone { .. }
                        | FormatError::Bars { .. },
                    ) => {
                        (StatusCode::BAD_REQUEST, "invalid_option")
                    }
                    Self::Format(FormatError::RigTooLarge { .. }) => {
                        (StatusCode::PAYLOAD_TOO_LARGE, "payload_too_large")
                    }
                    Self::Format(FormatError::Rig(_) | FormatError::Figure(_)) => {
                        (StatusCode::UNPROCESSABLE_ENTITY, "unusable_rig")
                    }
                    Self::Format(_) => (StatusCode::INTERNAL_SERVER_ERROR, "internal"),
                }
            }

            fn retry_after(&self) -> Option<Seconds> {
                match self {
                    $(Self::$busy { retry_after, .. } => Some(*retry_after),)+
                    // About the time to restart a server that is not ready.
                    Self::ModelStopped => Some(Seconds::new(30)),
                    // Next to impossible, as the model's own queue has a place for every permit; a
                    // place is free again after a step of the model.
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
    };
}

errors! {
    retry {
        TOO_MANY_REQUESTS "queue_full" QueueFull { queue: usize, retry_after: Seconds }
            => "{queue} requests are waiting already: {}", again(retry_after);
        TOO_MANY_REQUESTS "too_many_uploads" TooManyUploads { most: usize, retry_after: Seconds }
            => "{most} uploads are in transfer already: {}", again(retry_after);
        TOO_MANY_REQUESTS "upload_memory" UploadMemory { memory: ByteSize, retry_after: Seconds }
            => "uploads take all of their memory, {memory}: {}", again(retry_after);
        TOO_MANY_REQUESTS "rate_limited" RateLimited { per_minute: u32, retry_after: Seconds }
            => "only {per_minute} requests a minute are allowed: {}", again(retry_after);
        TOO_MANY_REQUESTS "too_many_jobs" TooManyJobs { most: usize, retry_after: Seconds }
            => "{most} jobs are kept already: fetch and delete finished ones, or {}",
            again(retry_after);
        TOO_MANY_REQUESTS "upload_displaced" UploadDisplaced { retry_after: Seconds }
            => "this upload was the slowest of too many and made room for another: {}",
            again(retry_after);
        TOO_MANY_REQUESTS "answer_memory" UnreadAnswers { memory: ByteSize, retry_after: Seconds }
            => "unread responses of yours take your share of their memory, {memory}: read or close \
                them, or {}",
            again(retry_after);
        SERVICE_UNAVAILABLE "too_many_connections" Spare { retry_after: Seconds }
            => "too many connections are busy, of this client or in all: {}", again(retry_after);
        SERVICE_UNAVAILABLE "job_timeout" JobTimeout { limit: Seconds, retry_after: Seconds }
            => "the job was not done within {limit} s of work: send a shorter part, or {}",
            again(retry_after);
        SERVICE_UNAVAILABLE "job_store" JobStore { retry_after: Seconds }
            => "jobs cannot be kept or found now, for their store does not answer: {}",
            again(retry_after);
        SERVICE_UNAVAILABLE "job_bytes" JobBytes { bytes: ByteSize, retry_after: Seconds }
            => "songs and results, those of waiting jobs included, take all of their space, \
                {bytes}: fetch and delete finished jobs, or {}",
            again(retry_after);
        SERVICE_UNAVAILABLE "answer_memory" AnswerMemory { memory: ByteSize, retry_after: Seconds }
            => "unread responses take all of their memory, {memory}: {}", again(retry_after);
        SERVICE_UNAVAILABLE "draining" Draining { retry_after: Seconds }
            => "the server is shutting down: {}", again(retry_after);
        SERVICE_UNAVAILABLE "loading" Loading { retry_after: Seconds }
            => "the model is being loaded: {}", again(retry_after);
        SERVICE_UNAVAILABLE "timeout" Timeout { limit: Seconds, retry_after: Seconds }
            => "there was no result within {limit} s: {}, or send a shorter part",
            again(retry_after);
    }
    refuse {
        BAD_REQUEST "invalid_option" Option { name: String, problem: String }
            => "option `{name}`: {problem}";
        BAD_REQUEST "invalid_multipart" Multipart(String) => "{0}";
        BAD_REQUEST "missing_audio" MissingAudio
            => "no audio was sent: send a file as part `file` of multipart/form-data, or as the \
                body itself with content type audio/*, or send pose codes as `codes`";
        BAD_REQUEST "missing_audio" EmptyAudio
            => "the file of part `file` is empty: 0 bytes arrived, so send the audio itself";
        BAD_REQUEST "upload_broken" UploadBroken => "the upload broke off before its end";
        BAD_REQUEST "wrong_host" Host
            => "the request must name one host (RFC 9112, section 3.2)";
        MISDIRECTED_REQUEST "wrong_host" OtherHost { host: String }
            => "{host:?} is none of the hosts that this server answers for";
        UNAUTHORIZED "missing_api_key" KeyMissing
            => "an API key is required: send it as `Authorization: Bearer KEY` or `X-API-Key: KEY`";
        UNAUTHORIZED "wrong_api_key" KeyWrong => "this API key is unknown";
        NOT_FOUND "not_found" NotFound { path: String }
            => "there is nothing at {path}: GET /docs lists all routes";
        NOT_FOUND "no_such_job" NoJob { id: String }
            => "there is no job {id}: it was deleted, has expired, or never existed";
        METHOD_NOT_ALLOWED "method_not_allowed" MethodNotAllowed { path: String, method: String }
            => "{path} does not accept {method}: GET /docs lists all routes";
        NOT_ACCEPTABLE "not_acceptable" NotAcceptable { asked: String, available: String }
            => "the Accept header asks for {asked:?}, which is not available: expected {available}";
        REQUEST_TIMEOUT "upload_timeout"
            UploadTimeout { idle: Seconds, total: Seconds, rate: ByteSize }
            => "the body was not sent in time: {rate} a second over every {idle} s are asked, and \
                {total} s in all allowed";
        GONE "job_expired" JobExpired
            => "the job had not begun when the time of its option `expires_s` was over";
        GONE "job_files_gone" FilesGone
            => "the song or the result of this job is no longer in the store: order it again";
        RANGE_NOT_SATISFIABLE "range_not_satisfiable" Range { size: u64 }
            => "the header Range asks for bytes that are not there: the result has {size}";
        UNPROCESSABLE_ENTITY "idempotency_key_reused" KeyReused
            => "this Idempotency-Key was sent before with another request: send the same song and \
                options with it, or another key";
        CONFLICT "job_not_done" JobNotDone { id: String, state: &'static str }
            => "job {id} is not done: it is {state}";
        PAYLOAD_TOO_LARGE "payload_too_large"
            TooLarge { limit: ByteSize, lossy: ByteSize, lossless: ByteSize }
            => "the audio is larger than {limit}: up to {lossy} is accepted, up to {lossless} for \
                wav, aiff and flac";
        UNSUPPORTED_MEDIA_TYPE "unsupported_media_type" UnsupportedMedia(String) => "{0}";
        UNPROCESSABLE_ENTITY "unusable_rig" RigTooLong { bytes: ByteSize, memory: ByteSize }
            => "the dance on this rig could take {bytes}, and all answers have {memory}: choose a \
                shorter part with `duration_s`, a lower `fps`, or a rig with fewer bones";
        SERVICE_UNAVAILABLE "model_stopped" ModelStopped
            => "the model has stopped: the server must be started again";
        NOT_FOUND "no_model_here" NoModel
            => "this server has no model of its own: order a job at POST /jobs";
        NOT_FOUND "no_jobs_here" NoJobs
            => "this server only works on jobs that others take: order them there";
        INTERNAL_SERVER_ERROR "job_abandoned" Abandoned { starts: usize }
            => "the workers that began this job died of it, {starts} times";
        INTERNAL_SERVER_ERROR "internal" Internal(String) => "the server failed: {0}";
    }
}

fn again(after: &Seconds) -> String {
    format!("try again in {} s", after.retry_after())
}

impl From<EngineError> for ServerError {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Stopped => Self::ModelStopped,
            other => Self::Engine(other),
        }
    }
}

impl From<OptionError> for ServerError {
    fn from(OptionError { name, problem }: OptionError) -> Self {
        Self::Option { name, problem }
    }
}

/// An error on its way to the outermost layer, which knows the request's id and makes an
/// [`ErrorBody`] of it.
#[derive(Clone, Debug)]
pub(crate) struct Report {
    pub(crate) status: StatusCode,
    pub(crate) message: String,
    pub(crate) error_type: Cow<'static, str>,
    pub(crate) retry_after: Option<u64>,
    /// Whether it was counted before.
    pub(crate) repeated: bool,
}

impl Report {
    /// Marks the error as one that the request of another id has reported before.
    pub(crate) fn repeated(mut self, request_id: &str) -> Self {
        self.message = format!("{} (of the request {request_id})", self.message);
        self.repeated = true;
        self
    }

    /// Returns the body of a response, or of an event.
    pub(crate) fn body(&self, request_id: &str) -> ErrorBody {
        ErrorBody {
            error: self.message.clone(),
            error_type: self.error_type.clone().into_owned(),
            request_id: request_id.to_owned(),
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
        AudioError::TooShort { .. } | AudioError::PartTooShort { .. } => {
            (UNPROCESSABLE, "audio_too_short")
        }
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
    /// Whether the song goes on after the longest that was accepted.
    pub(crate) fn is_too_long(&self) -> bool {
        matches!(self, Self::Engine(EngineError::Audio(AudioError::TooLong { .. })))
    }

    /// Returns the status that it is answered with.
    pub(crate) fn status(&self) -> StatusCode {
        self.classify().0
    }

    /// Returns the error as the caller sees it. Faults of our own are logged here, and hidden.
    pub(crate) fn report(&self) -> Report {
        let report = self.shown();
        if report.status == StatusCode::INTERNAL_SERVER_ERROR {
            tracing::error!(error = %self, "request failed");
        }
        report
    }

    /// Returns the error as the caller would see it, and logs nothing: it may not have happened.
    pub(crate) fn shown(&self) -> Report {
        let (status, error_type) = self.classify();
        let told = matches!(self, Self::Abandoned { .. });
        let message = if status == StatusCode::INTERNAL_SERVER_ERROR && !told {
            "something went wrong inside the server: report it with the request_id".to_owned()
        } else {
            self.to_string()
        };
        Report {
            status,
            message,
            error_type: error_type.into(),
            retry_after: self.retry_after().map(Seconds::retry_after),
            repeated: false,
        }
    }

    /// Returns whether the work is still running and must be stopped.
    pub(crate) fn stops_work(&self) -> bool {
        matches!(self, Self::Timeout { .. } | Self::Draining { .. })
    }
}

impl IntoResponse for ServerError {
    fn into_response(self) -> Response<Body> {
        let mut response = self.report().into_response();
        if response.status() == StatusCode::UNAUTHORIZED {
            let scheme = HeaderValue::from_static("Bearer");
            response.headers_mut().insert(header::WWW_AUTHENTICATE, scheme);
        }
        response
    }
}

impl IntoResponse for Report {
    fn into_response(self) -> Response<Body> {
        let mut response = Response::new(Body::empty());
        *response.status_mut() = self.status;
        if let Some(seconds) = self.retry_after {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response.extensions_mut().insert(self);
        response
    }
}

/// Writes the body of an error. One that did not come from [`ServerError`] but from the router or a
/// layer keeps its status and gets a message that fits it.
pub(crate) fn write_body(response: Response<Body>, request_id: &str) -> Response<Body> {
    let (mut parts, _) = response.into_parts();
    let report = parts.extensions.remove::<Report>().unwrap_or_else(|| Report {
        status: parts.status,
        retry_after: None,
        repeated: false,
        message: parts
            .status
            .canonical_reason()
            .unwrap_or("the request cannot be answered")
            .to_lowercase(),
        error_type: Cow::Borrowed(match parts.status {
            StatusCode::NOT_FOUND => "not_found",
            status if status.is_server_error() => "internal",
            _ => "invalid_request",
        }),
    });
    let body = serde_json::json!(report.body(request_id)).to_string();
    parts.headers.remove(header::CONTENT_LENGTH);
    parts.headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    Response::from_parts(parts, Body::from(body))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_that_stops_meanwhile_is_reported_as_the_probe_reports_it() {
        let stopped = ServerError::from(EngineError::Stopped).report();
        let probed = ServerError::ModelStopped.report();
        assert_eq!(
            (stopped.status, &*stopped.error_type, stopped.retry_after),
            (StatusCode::SERVICE_UNAVAILABLE, "model_stopped", probed.retry_after)
        );
        assert!(stopped.retry_after.is_some());
    }

    #[test]
    fn a_lack_of_threads_is_not_blamed_on_the_upload() {
        let lack = AudioError::NoThread(std::io::ErrorKind::WouldBlock.into());
        let report = ServerError::from(EngineError::from(lack)).report();
        assert_eq!(report.status, StatusCode::SERVICE_UNAVAILABLE);
        assert!(report.retry_after.is_some());
    }
}
