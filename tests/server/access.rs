//! Keys, origins, and methods that do no work.

use axum::{
    body::Body,
    http::{Method, Request, StatusCode},
};
use bailando::server::{Access, Limits, ServerConfig};

use crate::{
    client::{app, app_for, get, raw, send},
    fake::Fake,
};

const KEY: &str = "a-key-that-nobody-guesses";

fn keyed() -> axum::Router {
    let access = Access {
        keys: vec!["another".parse().unwrap(), KEY.parse().unwrap()],
        ..Access::default()
    };
    app_for(&Fake::new(), &Limits::default(), access)
}

fn with(mut request: Request<Body>, name: &'static str, value: &str) -> Request<Body> {
    request.headers_mut().insert(name, value.parse().unwrap());
    request
}

#[tokio::test]
async fn work_needs_a_key_and_probes_do_not() {
    let app = keyed();
    let missing = send(&app, raw("", "song")).await;
    missing.expect_error(401, "missing_api_key");
    assert_eq!(missing.header("www-authenticate"), "Bearer");
    let wrong = send(&app, with(raw("", "song"), "x-api-key", "guess")).await;
    wrong.expect_error(401, "wrong_api_key");
    for request in [
        with(raw("", "song"), "x-api-key", KEY),
        with(raw("", "song"), "authorization", &format!("Bearer {KEY}")),
    ] {
        assert_eq!(send(&app, request).await.status, StatusCode::OK);
    }
    for path in ["/codes", "/codes/1/2", "/jobs/x", "/jobs/x/result"] {
        get(&app, path).await.expect_error(401, "missing_api_key");
    }
    for path in [
        "/health",
        "/ready",
        "/info",
        "/metrics",
        "/api-doc/openapi.json",
    ] {
        let answer = get(&app, path).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}");
        let text = String::from_utf8(answer.body).unwrap();
        assert!(!text.contains(KEY), "{path}");
    }
}

#[test]
fn settings_never_show_a_key() {
    let config = ServerConfig {
        api_key: vec![KEY.parse().unwrap()],
        ..ServerConfig::default()
    };
    assert!(!format!("{config:?}").contains(KEY));
    assert!(!format!("{:?}", config.access().unwrap()).contains(KEY));
    // A variable that is set to nothing must not open the server.
    let empty = ServerConfig {
        api_key: vec!["".parse().unwrap()],
        ..ServerConfig::default()
    };
    assert!(empty.access().is_err());
}

#[tokio::test]
async fn a_job_is_found_with_its_own_key_only() {
    let app = keyed();
    let order = crate::client::post("/jobs", "", "song");
    let accepted = send(&app, with(order, "x-api-key", KEY)).await;
    assert_eq!(accepted.status, StatusCode::ACCEPTED);
    let path = accepted.header("location").to_owned();
    let ask = |key: &str| {
        with(
            Request::get(&path).body(Body::empty()).unwrap(),
            "x-api-key",
            key,
        )
    };
    send(&app, ask("another"))
        .await
        .expect_error(404, "no_such_job");
    assert_eq!(send(&app, ask(KEY)).await.status, StatusCode::OK);
}

#[tokio::test]
async fn pages_of_allowed_origins_may_call() {
    let access = Access {
        origins: vec!["https://dance.example".parse().unwrap()],
        ..Access::default()
    };
    let app = app_for(&Fake::new(), &Limits::default(), access);
    let from = |origin: &str| with(raw("", "song"), "origin", origin);
    let answer = send(&app, from("https://dance.example")).await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(
        answer.header("access-control-allow-origin"),
        "https://dance.example"
    );
    let other = send(&app, from("https://other.example")).await;
    assert!(!other.headers.contains_key("access-control-allow-origin"));
    let preflight = Request::builder()
        .method(Method::OPTIONS)
        .uri("/generate")
        .header("origin", "https://dance.example")
        .header("access-control-request-method", "POST")
        .header("access-control-request-headers", "authorization")
        .body(Body::empty())
        .unwrap();
    let answer = send(&app, preflight).await;
    assert_eq!(answer.status, StatusCode::OK);
    assert!(
        answer
            .header("access-control-allow-methods")
            .contains("POST")
    );
    assert_eq!(
        answer.header("access-control-allow-headers"),
        "authorization"
    );
}

#[tokio::test]
async fn head_is_get_without_a_body_and_options_names_the_methods() {
    let app = app(&Fake::new(), &Limits::default());
    for path in ["/health", "/info", "/metrics", "/codes"] {
        let request = Request::head(path).body(Body::empty()).unwrap();
        let answer = send(&app, request).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}");
        assert!(answer.body.is_empty(), "{path}");
    }
    for (path, methods) in [("/health", "GET,HEAD"), ("/generate", "POST")] {
        let request = Request::options(path).body(Body::empty()).unwrap();
        let answer = send(&app, request).await;
        assert_eq!(answer.status, StatusCode::NO_CONTENT, "{path}");
        assert_eq!(answer.header("allow"), methods, "{path}");
    }
}
