//! Keys, origins, and methods that do no work.

use axum::{
    body::Body,
    http::{Method, Request, StatusCode},
};
use bailando::server::{Access, Limits, ServerConfig};

use crate::server::{
    client::{app, app_for, get, post, raw, refuse, send, succeed, with},
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

#[tokio::test]
async fn work_needs_a_key_and_probes_do_not() {
    let app = keyed();
    let missing = send(&app, raw("", "song")).await;
    missing.expect_error(401, "missing_api_key");
    assert_eq!(missing.header("www-authenticate"), "Bearer");
    let wrong = send(&app, with(raw("", "song"), "x-api-key", "guess")).await;
    wrong.expect_error(401, "wrong_api_key");
    succeed(&app, with(raw("", "song"), "x-api-key", KEY)).await;
    let bearer = format!("Bearer {KEY}");
    succeed(&app, with(raw("", "song"), "authorization", &bearer)).await;
    for path in ["/codes", "/codes/1/2", "/jobs/x", "/jobs/x/result"] {
        get(&app, path).await.expect_error(401, "missing_api_key");
    }
    for path in ["/health", "/ready", "/info", "/metrics", "/api-doc/openapi.json"] {
        let answer = get(&app, path).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}");
        let text = String::from_utf8(answer.body).unwrap();
        assert!(!text.contains(KEY), "{path}");
    }
}

#[test]
fn settings_never_show_a_key() {
    let config = ServerConfig { api_key: vec![KEY.parse().unwrap()], ..ServerConfig::default() };
    assert!(!format!("{config:?}").contains(KEY));
    assert!(!format!("{:?}", config.access().unwrap()).contains(KEY));
    // A variable that is set to nothing must not open the server.
    let empty = ServerConfig { api_key: vec!["".parse().unwrap()], ..ServerConfig::default() };
    assert!(empty.access().is_err());
}

#[tokio::test]
async fn a_job_is_found_with_its_own_key_only() {
    let app = keyed();
    let order = post("/jobs", "", "song");
    let accepted = send(&app, with(order, "x-api-key", KEY)).await;
    assert_eq!(accepted.status, StatusCode::ACCEPTED);
    let path = accepted.header("location").to_owned();
    let ask = |key: &str| {
        let request = Request::get(&path).body(Body::empty()).unwrap();
        with(request, "x-api-key", key)
    };
    refuse(&app, ask("another"), 404, "no_such_job").await;
    succeed(&app, ask(KEY)).await;
}

#[tokio::test]
async fn pages_of_allowed_origins_may_call() {
    let access =
        Access { origins: vec!["https://dance.example".parse().unwrap()], ..Access::default() };
    let app = app_for(&Fake::new(), &Limits::default(), access);
    let from = |origin: &str| with(raw("", "song"), "origin", origin);
    let answer = succeed(&app, from("https://dance.example")).await;
    assert_eq!(answer.header("access-control-allow-origin"), "https://dance.example");
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
    let answer = succeed(&app, preflight).await;
    assert!(answer.header("access-control-allow-methods").contains("POST"));
    assert_eq!(answer.header("access-control-allow-headers"), "authorization");
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
