//! The layers around every route: request id, trace, metrics, error shape, panics.

use std::{
    any::Any,
    convert::Infallible,
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{
    Router,
    body::{Body, HttpBody},
    extract::{MatchedPath, Request, State},
    http::{HeaderName, HeaderValue, Method, Response, header},
    middleware::{self, Next},
    response::{IntoResponse, IntoResponseParts, ResponseParts},
};
use futures_util::StreamExt;
use tower::ServiceBuilder;
use tower_http::{
    catch_panic::CatchPanicLayer,
    request_id::{MakeRequestUuid, PropagateRequestIdLayer, RequestId, SetRequestIdLayer},
    trace::TraceLayer,
};
use tracing::Span;

use crate::server::{
    blocking::panic_text,
    error::{Report, ServerError, write_body},
    layers::{
        client::{Client, Spare},
        host,
    },
    options::shorten,
    response::paced,
    state::SharedState,
};

pub(crate) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const TOTAL_TIME: HeaderName = HeaderName::from_static("x-total-time");
const LONGEST_REQUEST_ID: usize = 128;

/// Wraps `router`, outermost first: id, trace, error shape with time and count, panics.
pub(crate) fn wrap(router: Router, state: SharedState, hosts: &[String]) -> Router {
    let panics = Arc::clone(&state.metrics);
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
            .layer(middleware::from_fn_with_state((state, hosts.into()), finish))
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
    State((state, hosts)): State<(SharedState, Arc<[String]>)>,
    request: Request,
    next: Next,
) -> Response<Body> {
    let started = Instant::now();
    let id = request_id(&request).to_owned();
    let method = method_name(request.method());
    let route =
        request.extensions().get::<MatchedPath>().map_or("other", MatchedPath::as_str).to_owned();
    let client = Client::of_address(&request);
    let probe = PROBES.contains(&request.uri().path());
    let spare = request.extensions().get::<Spare>().is_some();
    let retry_after = state.limits.answer_idle_timeout;
    let mut response = match host::check(&request, &hosts[..]) {
        _ if probe => held(&state, client, next.run(request).await),
        Err(refused) => refused.into_response(),
        Ok(()) if spare => ServerError::Spare { retry_after }.into_response(),
        Ok(()) => held(&state, client, next.run(request).await),
    };
    let status = response.status().as_u16();
    let metrics = &state.metrics;
    metrics.answered(&route, method, status, started.elapsed());
    if let Some(report) = response.extensions().get::<Report>()
        && !report.repeated
    {
        metrics.rejected(&report.error_type);
    }
    if response.status().is_client_error() || response.status().is_server_error() {
        response = write_body(response, &id);
    }
    let total = time_header(started.elapsed());
    response.headers_mut().insert(TOTAL_TIME, total);
    response
}

/// What is answered whatever host was named, and on a connection beyond all places.
const PROBES: [&str; 3] = ["/health", "/ready", "/metrics"];
/// A response so small that its memory is that of its connection.
const SMALL: u64 = 1024;

/// How a response says what becomes of its body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Held {
    /// It is paced already, and its memory reserved.
    Paced,
    /// All readers share its bytes.
    Shared,
}

impl IntoResponseParts for Held {
    type Error = Infallible;

    fn into_response_parts(self, mut parts: ResponseParts) -> Result<ResponseParts, Infallible> {
        parts.extensions_mut().insert(self);
        Ok(parts)
    }
}

/// Counts a response among those that wait for their readers, and gives its reader a pace.
fn held(state: &SharedState, client: Client, response: Response<Body>) -> Response<Body> {
    let held = response.extensions().get::<Held>().copied();
    let length = response.body().size_hint().exact().unwrap_or(0);
    if held == Some(Held::Paced) || length <= SMALL {
        return response;
    }
    let room = match held {
        Some(_) => None,
        None => match state.resources.try_reserve_response(client, length) {
            Ok(room) => Some(room),
            Err(refused) => return refused.into_response(),
        },
    };
    let (mut parts, body) = response.into_parts();
    parts.headers.insert(header::CONTENT_LENGTH, HeaderValue::from(length));
    // A body that is there already: a reader who leaves loses it with its room.
    let data = body.into_data_stream().filter_map(move |part| {
        let _room = &room;
        std::future::ready(part.ok())
    });
    Response::from_parts(parts, paced::from_stream(data, state.pace()))
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
    use crate::server::{config::Limits, metrics::SharedMetrics, state::ServerState};

    #[tokio::test]
    async fn panics_of_handlers_are_counted() {
        async fn broken() -> &'static str {
            panic!("a panic that the test wants")
        }
        let metrics = SharedMetrics::default();
        let state = ServerState::loading(Limits::default(), Arc::clone(&metrics));
        let app = wrap(Router::new().route("/", get(broken)), state, &[]);
        let answer = app.oneshot(Request::new(Body::empty())).await.unwrap();
        assert_eq!(answer.status(), StatusCode::INTERNAL_SERVER_ERROR);
        let text = metrics.text().unwrap();
        assert!(text.contains("bailando_panics_total{place=\"handler\"} 1"), "{text}");
    }
}
