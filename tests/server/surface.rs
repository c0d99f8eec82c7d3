//! What the service says about itself.

use std::{path::Path, sync::atomic::Ordering};

use axum::{
    body::Body,
    http::{Request, StatusCode},
};
use bailando::server::{Limits, openapi_json};
use serde_json::Value;

use crate::{
    client::{app, get, send},
    fake::Fake,
};

/// `UPDATE_OPENAPI=1 cargo test --test server openapi` rewrites the committed document.
#[test]
fn openapi_document_is_the_committed_one() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi/openapi.json");
    let current = openapi_json().unwrap();
    if std::env::var_os("UPDATE_OPENAPI").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, &current).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap();
    assert!(
        committed == current,
        "openapi/openapi.json is out of date: UPDATE_OPENAPI=1 cargo test --test server openapi"
    );
}

#[tokio::test]
async fn openapi_document_is_served() {
    let app = app(&Fake::new(), &Limits::default());
    let answer = get(&app, "/api-doc/openapi.json").await;
    let committed: Value = serde_json::from_str(&openapi_json().unwrap()).unwrap();
    assert_eq!(answer.json(), committed);
}

#[tokio::test]
async fn every_documented_failure_has_the_error_schema() {
    let document: Value = serde_json::from_str(&openapi_json().unwrap()).unwrap();
    let mut failures = 0;
    for (path, methods) in document["paths"].as_object().unwrap() {
        for operation in methods.as_object().unwrap().values() {
            for (status, response) in operation["responses"].as_object().unwrap() {
                if status.starts_with(['4', '5']) {
                    failures += 1;
                    assert_eq!(
                        response["content"]["application/json"]["schema"]["$ref"],
                        "#/components/schemas/ErrorBody",
                        "{path} {status}"
                    );
                }
            }
        }
    }
    assert!(failures >= 10, "{failures}");
}

#[tokio::test]
async fn docs_page_and_its_assets_are_embedded() {
    let app = app(&Fake::new(), &Limits::default());
    let page = get(&app, "/docs").await;
    assert_eq!(page.status, StatusCode::SEE_OTHER);
    let page = get(&app, page.header("location")).await;
    assert_eq!(page.status, StatusCode::OK);
    let html = String::from_utf8(page.body).unwrap();
    assert!(html.contains("swagger-ui"));
    let script = get(&app, "/docs/swagger-ui-bundle.js").await;
    assert_eq!(script.status, StatusCode::OK);
    assert!(script.body.len() > 100_000);
    let setup = get(&app, "/docs/swagger-initializer.js").await;
    let setup = String::from_utf8(setup.body).unwrap();
    assert!(setup.contains("/api-doc/openapi.json"), "{setup}");
}

#[tokio::test]
async fn info_tells_the_model_and_every_limit() {
    let answer = get(&app(&Fake::new(), &Limits::default()), "/info").await;
    assert_eq!(answer.status, StatusCode::OK);
    let mut info = answer.json();
    assert_eq!(info["version"], env!("CARGO_PKG_VERSION"));
    info["version"] = "[version]".into();
    insta::assert_json_snapshot!(info);
}

#[tokio::test]
async fn probes_answer() {
    let app = app(&Fake::new(), &Limits::default());
    for path in ["/health", "/ready"] {
        let answer = get(&app, path).await;
        assert_eq!(answer.status, StatusCode::OK);
        assert!(!answer.header("x-request-id").is_empty());
        assert!(answer.header("x-total-time").parse::<f64>().is_ok());
    }
}

#[tokio::test]
async fn a_model_that_has_stopped_is_not_ready() {
    let fake = Fake::new();
    let app = app(&fake, &Limits::default());
    fake.stopped.store(true, Ordering::SeqCst);
    get(&app, "/ready").await.expect_error(503, "model_stopped");
    assert_eq!(get(&app, "/health").await.status, StatusCode::OK);
}

#[tokio::test]
async fn unknown_paths_and_methods_have_the_error_shape() {
    let app = app(&Fake::new(), &Limits::default());
    get(&app, "/no/such/path")
        .await
        .expect_error(404, "not_found");
    get(&app, "/docs/no-such-asset")
        .await
        .expect_error(404, "not_found");
    let answer = get(&app, "/generate").await;
    answer.expect_error(405, "method_not_allowed");
    assert_eq!(answer.header("allow"), "POST");
    for path in ["/health", "/ready", "/info", "/api-doc/openapi.json"] {
        let request = Request::delete(path).body(Body::empty()).unwrap();
        send(&app, request)
            .await
            .expect_error(405, "method_not_allowed");
    }
}
