//! What every request and answer wears: an id, a trace, a total time, one error shape.

use std::{any::Any, time::Duration};

use axum::{
    Router,
    body::Body,
    extract::Request,
    http::{HeaderName, HeaderValue, Response},
    middleware::{self, Next},
    response::IntoResponse,
};
use std::time::Instant;
use tower::ServiceBuilder;
use tower_http::{
    catch_panic::CatchPanicLayer,
    request_id::{MakeRequestUuid, PropagateRequestIdLayer, RequestId, SetRequestIdLayer},
    trace::TraceLayer,
};
use tracing::Span;

use super::error::{ServerError, write_body};

pub(crate) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const TOTAL_TIME: HeaderName = HeaderName::from_static("x-total-time");
const LONGEST_REQUEST_ID: usize = 128;

/// Puts `router` into its layers, outermost first: id, trace, error shape and time, panics.
pub(crate) fn wrap(router: Router) -> Router {
    router.layer(
        ServiceBuilder::new()
            .map_request(drop_odd_request_id)
            .layer(SetRequestIdLayer::new(REQUEST_ID, MakeRequestUuid))
            .layer(PropagateRequestIdLayer::new(REQUEST_ID))
            .layer(
                TraceLayer::new_for_http()
                    .make_span_with(request_span)
                    .on_request(())
                    .on_response(log_response)
                    .on_body_chunk(())
                    .on_eos(())
                    .on_failure(()),
            )
            .layer(middleware::from_fn(finish))
            .layer(CatchPanicLayer::custom(answer_panic)),
    )
}

/// An id that came with the request is taken over if it cannot hurt a log line.
fn drop_odd_request_id(mut request: Request) -> Request {
    let sane = |id: &HeaderValue| {
        let id = id.as_bytes();
        (1..=LONGEST_REQUEST_ID).contains(&id.len())
            && id
                .iter()
                .all(|b| b.is_ascii_alphanumeric() || b"-_.:/+=".contains(b))
    };
    if request
        .headers()
        .get(REQUEST_ID)
        .is_some_and(|id| !sane(id))
    {
        request.headers_mut().remove(REQUEST_ID);
    }
    request
}

fn request_id(request: &Request) -> &str {
    request
        .extensions()
        .get::<RequestId>()
        .and_then(|id| id.header_value().to_str().ok())
        .unwrap_or_default()
}

/// The path without its query: options may grow secrets one day, and logs are no place for them.
fn request_span(request: &Request) -> Span {
    tracing::info_span!(
        "request",
        method = %request.method(),
        path = request.uri().path(),
        request_id = request_id(request),
    )
}

fn log_response<B>(response: &Response<B>, latency: Duration, _span: &Span) {
    tracing::info!(
        status = response.status().as_u16(),
        latency_ms = milliseconds(latency),
        "answered"
    );
}

async fn finish(request: Request, next: Next) -> Response<Body> {
    let started = Instant::now();
    let id = request_id(&request).to_owned();
    let mut response = next.run(request).await;
    if response.status().is_client_error() || response.status().is_server_error() {
        response = write_body(response, &id);
    }
    let total = time_header(started.elapsed());
    response.headers_mut().insert(TOTAL_TIME, total);
    response
}

fn answer_panic(panic: Box<dyn Any + Send>) -> Response<Body> {
    ServerError::Internal(format!("panic: {}", panic_text(panic.as_ref()))).into_response()
}

/// The message of a panic, as far as it has one.
pub(crate) fn panic_text(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("without a message")
}

/// Milliseconds, to the microsecond.
pub(crate) fn milliseconds(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e6).round() / 1e3
}

/// A time as the value of an `x-..-time` header.
pub(crate) fn time_header(time: Duration) -> HeaderValue {
    // The text of a finite number is always a legal header value.
    HeaderValue::from_str(&milliseconds(time).to_string())
        .unwrap_or_else(|_| HeaderValue::from_static("0"))
}
