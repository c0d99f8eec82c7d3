//! What every request and answer wears: an id, a trace, a total time, one error shape.

use std::{
    any::Any,
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{
    Router,
    body::Body,
    extract::{MatchedPath, Request, State},
    http::{HeaderName, HeaderValue, Method, Response},
    middleware::{self, Next},
    response::IntoResponse,
};
use tower::ServiceBuilder;
use tower_http::{
    catch_panic::CatchPanicLayer,
    request_id::{MakeRequestUuid, PropagateRequestIdLayer, RequestId, SetRequestIdLayer},
    trace::TraceLayer,
};
use tracing::Span;

use super::{
    error::{Report, ServerError, write_body},
    options::shorten,
    state::SharedState,
};

pub(crate) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const TOTAL_TIME: HeaderName = HeaderName::from_static("x-total-time");
const LONGEST_REQUEST_ID: usize = 128;

/// Puts `router` into its layers, outermost first: id, trace, error shape, time and count, panics.
pub(crate) fn wrap(router: Router, state: &SharedState) -> Router {
    let state = Arc::clone(state);
    // Around each route, so that its pattern is known; and the same around what has none.
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
            .layer(middleware::from_fn_with_state(state, finish))
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

pub(crate) fn request_id(request: &Request) -> &str {
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
        path = shorten(request.uri().path()),
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

async fn finish(State(state): State<SharedState>, request: Request, next: Next) -> Response<Body> {
    let started = Instant::now();
    let id = request_id(&request).to_owned();
    let method = method_name(request.method());
    let route = request
        .extensions()
        .get::<MatchedPath>()
        .map_or("other", MatchedPath::as_str)
        .to_owned();
    let mut response = next.run(request).await;
    let status = response.status().as_u16();
    state
        .metrics
        .answered(&route, method, status, started.elapsed());
    if let Some(report) = response.extensions().get::<Report>()
        && !report.repeated
    {
        state.metrics.rejected(report.error_type);
    }
    if response.status().is_client_error() || response.status().is_server_error() {
        response = write_body(response, &id);
    }
    let total = time_header(started.elapsed());
    response.headers_mut().insert(TOTAL_TIME, total);
    response
}

/// Methods that we know; anybody can make others up.
fn method_name(method: &Method) -> &'static str {
    match *method {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::POST => "POST",
        Method::DELETE => "DELETE",
        Method::OPTIONS => "OPTIONS",
        _ => "other",
    }
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

/// Milliseconds, to the microsecond, as the JSON of a dance has them.
pub(crate) fn milliseconds(time: Duration) -> f64 {
    time.as_micros() as f64 / 1e3
}

/// A time as the value of an `x-..-time` header.
pub(crate) fn time_header(time: Duration) -> HeaderValue {
    // The text of a finite number is always a legal header value.
    HeaderValue::from_str(&milliseconds(time).to_string())
        .unwrap_or_else(|_| HeaderValue::from_static("0"))
}
