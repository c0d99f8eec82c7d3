//! What the service says about itself.

use std::{path::Path, sync::atomic::Ordering};

use axum::{
    body::Body,
    http::{Request, StatusCode},
};
use bailando::server::{Limits, openapi_json};
use serde_json::Value;

use crate::server::{
    client::{app, get, raw, refuse, succeed},
    fake::Fake,
};

/// `UPDATE_OPENAPI=1 cargo test -p bailando --test main openapi` rewrites the committed document.
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
        "openapi/openapi.json is out of date: UPDATE_OPENAPI=1 cargo test -p bailando --test main \
         openapi"
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
    // Ours: no invented values, and no page that stands still (web/e2e/docs.test.mjs).
    assert!(setup.contains("ParameterIncludeEmpty") && setup.contains("LONGEST_SHOWN"), "{setup}");
}

#[tokio::test]
async fn info_tells_the_model_and_every_limit() {
    let app = app(&Fake::new(), &Limits::default());
    let answer = get(&app, "/info").await;
    assert_eq!(answer.status, StatusCode::OK);
    let mut info = answer.json();
    assert_eq!(info["version"], env!("CARGO_PKG_VERSION"));
    info["version"] = "[version]".into();
    insta::assert_json_snapshot!(info);
    // In the document they have the names under which they are sent.
    let document = get(&app, "/api-doc/openapi.json").await.json();
    let described = document["components"]["schemas"]["Limits"]["properties"].as_object().unwrap();
    let sent = info["limits"].as_object().unwrap();
    let missing: Vec<_> = described.keys().filter(|name| !sent.contains_key(*name)).collect();
    assert!(missing.is_empty(), "{missing:?}");
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
    get(&app, "/no/such/path").await.expect_error(404, "not_found");
    get(&app, "/docs/no-such-asset").await.expect_error(404, "not_found");
    let answer = get(&app, "/generate").await;
    answer.expect_error(405, "method_not_allowed");
    assert_eq!(answer.header("allow"), "POST");
    for path in ["/health", "/ready", "/info", "/api-doc/openapi.json"] {
        let request = Request::delete(path).body(Body::empty()).unwrap();
        refuse(&app, request, 405, "method_not_allowed").await;
    }
}

#[tokio::test]
async fn metrics_are_what_prometheus_reads() {
    let app = app(&Fake::new(), &Limits::default());
    let missing = get(&app, "/nothing/here").await;
    missing.expect_error(404, "not_found");
    succeed(&app, raw("", "song")).await;
    let answer = get(&app, "/metrics").await;
    assert!(answer.header("content-type").starts_with("application/openmetrics-text"));
    let text = String::from_utf8(answer.body).unwrap();
    for line in [
        "bailando_http_requests_total{route=\"other\",method=\"GET\",status=\"404\"} 1",
        "bailando_http_requests_total{route=\"/generate\",method=\"POST\",status=\"200\"} 1",
        "bailando_rejected_total{reason=\"not_found\"} 1",
        "bailando_dances_total{kind=\"generate\"} 1",
        "bailando_stage_duration_seconds_count{stage=\"write\"} 1",
        "bailando_requests_running 0",
        "bailando_uploads 0",
        "bailando_upload_bytes 0",
        "bailando_audio_seconds_in_flight 0",
    ] {
        assert!(text.lines().any(|found| found == line), "{line}\n{text}");
    }
    // Every metric says what it is.
    for line in text.lines().filter(|line| line.starts_with("# TYPE ")) {
        let name = line.split(' ').nth(2).unwrap();
        assert!(text.contains(&format!("# HELP {name} ")), "{name}");
    }
}

#[tokio::test]
async fn pose_codes_can_be_looked_at() {
    let app = app(&Fake::new(), &Limits::default());
    let books = get(&app, "/codes").await.json();
    assert_eq!((&books["upper"], &books["lower"]), (&512.into(), &512.into()));
    assert_eq!(books["start_codes"][0], serde_json::json!([1, 2]));
    let suppressed = serde_json::json!({"upper": [], "lower": [7]});
    assert_eq!(books["suppressed_codes"], suppressed);
    let pose = get(&app, "/codes/3/511").await.json();
    assert_eq!((&pose["upper"], &pose["lower"]), (&3.into(), &511.into()));
    assert_eq!(pose["positions"].as_array().unwrap().len(), pose["frames"]);
    let said = get(&app, "/codes/512/0").await.expect_error(400, "invalid_option");
    assert!(said.contains("option `upper`: 512 is not between 0 and 511"), "{said}");
    get(&app, "/codes/a/b").await.expect_error(400, "invalid_option");
}
