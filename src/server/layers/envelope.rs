//! The layers around every route: request id, trace, metrics, error shape, panics.

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

use crate::server::{
    error::{Report, ServerError, write_body},
    metrics::SharedMetrics,
    options::shorten,
};

pub(crate) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const TOTAL_TIME: HeaderName = HeaderName::from_static("x-total-time");
const LONGEST_REQUEST_ID: usize = 128;

/// Wraps `router`, outermost first: id, trace, error shape with time and count, panics.
pub(crate) fn wrap(router: Router, metrics: SharedMetrics) -> Router {
    let panics = Arc::clone(&metrics);
    // Around each route, so that its pattern is known, and around the fallback.
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
            .layer(middleware::from_fn_with_state(metrics, finish))
            .layer(CatchPanicLayer::custom(move |panic: Box<dyn Any + Send>| {
                panics.panicked("handler");
                answer_panic(panic.as_ref())
            })),
    )
}

/// Keeps an id that came with the request only if it cannot harm a log line.
fn drop_odd_request_id(mut request: Request) -> Request {
    let sane = |id: &HeaderValue| {
        let id = id.as_bytes();
        (1..=LONGEST_REQUEST_ID).contains(&id.len())
            && id.iter().all(|b| b.is_ascii_alphanumeric() || b"-_.:/+=".contains(b))
    };
    if request.headers().get(REQUEST_ID).is_some_and(|id| !sane(id)) {
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

/// Names the path without its query: options may hold secrets one day, which no log may show.
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

async fn finish(
    State(metrics): State<SharedMetrics>,
    request: Request,
    next: Next,
) -> Response<Body> {
    let started = Instant::now();
    let id = request_id(&request).to_owned();
    let method = method_name(request.method());
    let route =
        request.extensions().get::<MatchedPath>().map_or("other", MatchedPath::as_str).to_owned();
    let mut response = next.run(request).await;
    let status = response.status().as_u16();
    metrics.answered(&route, method, status, started.elapsed());
    if let Some(report) = response.extensions().get::<Report>()
        && !report.repeated
    {
        metrics.rejected(report.error_type);
    }
    if response.status().is_client_error() || response.status().is_server_error() {
        response = write_body(response, &id);
    }
    let total = time_header(started.elapsed());
    response.headers_mut().insert(TOTAL_TIME, total);
    response
}

/// Names the methods of ours: callers can make others up.
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

fn answer_panic(panic: &(dyn Any + Send)) -> Response<Body> {
    ServerError::Internal(format!("panic: {}", panic_text(panic))).into_response()
}

/// Returns the message of a panic, as far as it has one.
pub(crate) fn panic_text(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("without a message")
}

/// Returns milliseconds, to the microsecond, as the JSON result has them.
pub(crate) fn milliseconds(time: Duration) -> f64 {
    time.as_micros() as f64 / 1e3
}

/// Returns a time as the value of an `x-..-time` header.
pub(crate) fn time_header(time: Duration) -> HeaderValue {
    // The text of a finite number is always a legal header value.
    HeaderValue::from_str(&milliseconds(time).to_string())
        .unwrap_or_else(|_| HeaderValue::from_static("0"))
}

#[cfg(test)]
mod tests {
    use axum::{http::StatusCode, routing::get};
    use tower::ServiceExt;

    use super::*;

    #[tokio::test]
    async fn panics_of_handlers_are_counted() {
        async fn broken() -> &'static str {
            panic!("a panic that the test wants")
        }
        let metrics = SharedMetrics::default();
        let app = wrap(Router::new().route("/", get(broken)), Arc::clone(&metrics));
        let answer = app.oneshot(Request::new(Body::empty())).await.unwrap();
        assert_eq!(answer.status(), StatusCode::INTERNAL_SERVER_ERROR);
        let text = metrics.text().unwrap();
        assert!(text.contains("bailando_panics_total{place=\"handler\"} 1"), "{text}");
    }
}
