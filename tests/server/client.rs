//! Requests and what came back.

use std::{
    num::NonZeroUsize,
    sync::Arc,
    time::{Duration, Instant},
};

use axum::{
    Router,
    body::Body,
    http::{HeaderMap, Method, Request, StatusCode, header},
};
use bailando::server::{Access, Generate, Limits, router};
use http_body_util::BodyExt;
use serde_json::Value;
use tokio::task::JoinHandle;
use tower::ServiceExt;

/// Far more than any step needs, far less than the timeouts of requests.
pub(crate) const LONG: Duration = Duration::from_secs(15);

/// Returns what `look` finds, as soon as it finds something.
pub(crate) async fn eventually<T>(what: &str, mut look: impl AsyncFnMut() -> Option<T>) -> T {
    let started = Instant::now();
    loop {
        if let Some(found) = look().await {
            return found;
        }
        assert!(started.elapsed() < LONG, "it never happens that {what}");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

/// Waits until the metrics have all of `lines`.
pub(crate) async fn until_counted(app: &Router, lines: &[&str]) {
    let what = format!("the metrics say {lines:?}");
    eventually(&what, async || {
        let metrics = String::from_utf8(get(app, "/metrics").await.body).unwrap();
        let said = |line: &&str| metrics.lines().any(|found| found == *line);
        lines.iter().all(said).then_some(())
    })
    .await;
}

/// A response, read to its end.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: StatusCode,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| {
            let text = String::from_utf8_lossy(&self.body);
            panic!("{} is not JSON ({error}): {text}", self.status)
        })
    }

    pub(crate) fn header(&self, name: &str) -> &str {
        self.headers
            .get(name)
            .unwrap_or_else(|| panic!("{} without {name}: {:?}", self.status, self.headers))
            .to_str()
            .unwrap()
    }

    /// Checks that this is an error in the one shape, and returns its message.
    #[track_caller]
    pub(crate) fn expect_error(&self, status: u16, error_type: &str) -> String {
        let body = self.json();
        assert_eq!(
            (self.status.as_u16(), body["error_type"].as_str()),
            (status, Some(error_type)),
            "{body}"
        );
        let fields: Vec<_> = body.as_object().unwrap().keys().collect();
        assert_eq!(fields, ["error", "error_type", "request_id"]);
        assert_eq!(body["request_id"], self.header("x-request-id"));
        assert_eq!(self.header("content-type"), "application/json");
        if [429, 503].contains(&status) {
            assert!(self.header("retry-after").parse::<u64>().unwrap() >= 1);
        }
        body["error"].as_str().unwrap().to_owned()
    }
}

/// Limits that tests can reach: one request runs, one waits.
pub(crate) fn small_limits() -> Limits {
    Limits { max_concurrent_requests: NonZeroUsize::MIN, queue: 1, ..Limits::default() }
}

pub(crate) fn app(engine: &Arc<impl Generate>, limits: &Limits) -> Router {
    app_for(engine, limits, Access::default())
}

/// With keys and origins.
pub(crate) fn app_for(engine: &Arc<impl Generate>, limits: &Limits, access: Access) -> Router {
    let engine = Arc::clone(engine) as Arc<dyn Generate>;
    router(engine, limits.clone(), access)
}

pub(crate) async fn send(app: &Router, request: Request<Body>) -> Answer {
    let response = app.clone().oneshot(request).await.unwrap();
    let (parts, body) = response.into_parts();
    Answer {
        status: parts.status,
        headers: parts.headers,
        body: body.collect().await.unwrap().to_bytes().to_vec(),
    }
}

/// Sends `request`, which must succeed.
pub(crate) async fn succeed(app: &Router, request: Request<Body>) -> Answer {
    let answer = send(app, request).await;
    let text = String::from_utf8_lossy(&answer.body);
    assert_eq!(answer.status, StatusCode::OK, "{text}");
    answer
}

/// Sends `request`, which must be refused, and returns the message.
pub(crate) async fn refuse(
    app: &Router,
    request: Request<Body>,
    status: u16,
    kind: &str,
) -> String {
    send(app, request).await.expect_error(status, kind)
}

/// Sends `request` meanwhile.
pub(crate) fn spawn(app: &Router, request: Request<Body>) -> JoinHandle<Answer> {
    let app = app.clone();
    tokio::spawn(async move { send(&app, request).await })
}

/// Adds a header to `request`, or replaces it.
pub(crate) fn with(mut request: Request<Body>, name: &'static str, value: &str) -> Request<Body> {
    request.headers_mut().insert(name, value.parse().unwrap());
    request
}

pub(crate) async fn get(app: &Router, path: &str) -> Answer {
    send(app, Request::get(path).body(Body::empty()).unwrap()).await
}

/// `POST /generate?query` with the audio as the body.
pub(crate) fn raw(query: &str, audio: impl Into<Body>) -> Request<Body> {
    post("/generate", query, audio)
}

/// `POST path?query` with the audio as the body.
pub(crate) fn post(path: &str, query: &str, audio: impl Into<Body>) -> Request<Body> {
    Request::builder()
        .method(Method::POST)
        .uri(format!("{path}?{query}"))
        .header(header::CONTENT_TYPE, "audio/mpeg")
        .body(audio.into())
        .unwrap()
}

/// `POST /generate?query` as a form.
pub(crate) fn form(query: &str, parts: &[(&str, &[u8])]) -> Request<Body> {
    let mut body = Vec::new();
    for (name, value) in parts {
        let file = match *name {
            "file" => "; filename=\"song.mp3\"\r\nContent-Type: audio/mpeg",
            _ => "",
        };
        let head =
            format!("--frontier\r\nContent-Disposition: form-data; name=\"{name}\"{file}\r\n\r\n");
        body.extend([head.as_bytes(), value, b"\r\n"].concat());
    }
    body.extend(b"--frontier--\r\n");
    let kind = "multipart/form-data; boundary=frontier";
    with(raw(query, body), "content-type", kind)
}
