//! Dances that are sent while they are made.

use std::{sync::atomic::Ordering, time::Duration};

use axum::{
    Router,
    body::Body,
    http::{HeaderValue, Request, StatusCode, header},
};
use bailando::server::{Limits, Seconds};
use http_body_util::BodyExt;
use serde_json::Value;
use tower::ServiceExt;

use crate::server::{
    client::{Answer, app, get, post, send, small_limits, until_counted},
    fake::{BLOCK, Fake, LATE_PANIC, PANIC},
};

/// The objects of a stream in lines.
pub(crate) fn lines(answer: &Answer) -> Vec<Value> {
    let text = std::str::from_utf8(&answer.body).unwrap();
    let lines = text.lines();
    lines.map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Names and objects of server-sent events.
fn events(answer: &Answer) -> Vec<(String, Value)> {
    let text = std::str::from_utf8(&answer.body).unwrap();
    let events = text.split_terminator("\n\n").map(|event| {
        let (name, data) = event.split_once('\n').unwrap();
        let name = name.strip_prefix("event: ").unwrap();
        let data = data.strip_prefix("data: ").unwrap();
        (name.to_owned(), serde_json::from_str(data).unwrap())
    });
    events.collect()
}

pub(crate) fn in_lines(mut request: Request<Body>) -> Request<Body> {
    let lines = HeaderValue::from_static("application/x-ndjson");
    request.headers_mut().insert(header::ACCEPT, lines);
    request
}

fn stream(query: &str, audio: &'static [u8]) -> Request<Body> {
    post("/generate/stream", query, audio)
}

#[tokio::test]
async fn events_are_a_start_frames_in_order_and_an_end() {
    let app = app(&Fake::new(), &Limits::default());
    let answer = send(&app, stream("include=rotations&seed=9", b"song")).await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.header("content-type"), "text/event-stream");
    assert_eq!(answer.header("x-seed"), "9");
    let events = events(&answer);
    for (name, object) in &events {
        assert_eq!(object["event"], name.as_str());
    }
    let (_, start) = &events[0];
    assert_eq!((&start["event"], &start["frames"]), (&"start".into(), &8.into()));
    assert_eq!(start["skeleton"]["joints"].as_array().unwrap().len(), 3);
    assert_eq!(start["music"]["beats_s"].as_array().unwrap().len(), 2);
    let mut next = 0;
    for (name, frames) in &events[1..events.len() - 1] {
        assert_eq!(name, "frames");
        assert_eq!(frames["first"], next);
        let count = frames["count"].as_u64().unwrap();
        for array in ["positions", "rotations", "root"] {
            assert_eq!(frames[array].as_array().unwrap().len() as u64, count, "{array}");
        }
        next += count;
    }
    let (name, done) = events.last().unwrap();
    assert_eq!((name.as_str(), &done["frames"]), ("done", &8.into()));
    assert_eq!(next, 8);
    assert!(done["tail"].as_str().unwrap().len() > 20);
}

#[tokio::test]
async fn the_same_objects_come_as_lines() {
    let app = app(&Fake::new(), &Limits::default());
    let answer = send(&app, in_lines(stream("encoding=base64", b"song"))).await;
    assert_eq!(answer.header("content-type"), "application/x-ndjson");
    let lines = lines(&answer);
    let names: Vec<_> = lines.iter().map(|line| &line["event"]).collect();
    assert_eq!(names, ["start", "frames", "done"]);
    assert_eq!(lines[1]["positions"].as_str().unwrap().len(), 8 * 3 * 3 * 4 / 3 * 4);
    assert!(!lines[1].as_object().unwrap().contains_key("rotations"));
}

#[tokio::test]
async fn what_is_wrong_is_said_before_the_stream_begins() {
    let app = app(&Fake::new(), &Limits::default());
    let bvh = send(&app, stream("format=bvh", b"song")).await;
    bvh.expect_error(400, "invalid_option");
    let empty = send(&app, stream("", b"")).await;
    empty.expect_error(400, "missing_audio");
    let panicked = send(&app, stream("", PANIC)).await;
    panicked.expect_error(500, "internal");
    let mut picture = stream("", b"song");
    let wanted = HeaderValue::from_static("image/png");
    picture.headers_mut().insert(header::ACCEPT, wanted);
    send(&app, picture).await.expect_error(406, "not_acceptable");
}

#[tokio::test]
async fn what_goes_wrong_later_is_the_last_event() {
    let app = app(&Fake::new(), &small_limits());
    let answer = send(&app, in_lines(stream("", LATE_PANIC))).await;
    assert_eq!(answer.status, StatusCode::OK);
    let lines = lines(&answer);
    let last = lines.last().unwrap();
    assert_eq!((&last["event"], &last["error_type"]), (&"error".into(), &"internal".into()));
    assert_eq!(last["request_id"], answer.header("x-request-id"));
    let metrics = String::from_utf8(get(&app, "/metrics").await.body).unwrap();
    assert!(metrics.contains("bailando_panics_total{place=\"inference\"} 1"), "{metrics}");
    assert_eq!(send(&app, stream("", b"song")).await.status, StatusCode::OK);
}

#[tokio::test]
async fn a_stream_that_takes_too_long_ends_with_an_error() {
    let fake = Fake::new();
    let limits = Limits { request_timeout: Seconds(Duration::from_millis(500)), ..small_limits() };
    let answer = send(&app(&fake, &limits), in_lines(stream("", BLOCK))).await;
    let lines = lines(&answer);
    assert_eq!(lines.last().unwrap()["error_type"], "timeout");
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
}

/// The work stops when the time is over, not when its reader comes to the end.
#[tokio::test]
async fn a_stream_that_takes_too_long_stops_though_nobody_reads_it() {
    let fake = Fake::new();
    let limits = Limits { request_timeout: Seconds(Duration::from_millis(500)), ..small_limits() };
    let app = app(&fake, &limits);
    let body = begin(&app).await;
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    let rest = body.collect().await.unwrap().to_bytes();
    let rest = String::from_utf8(rest.to_vec()).unwrap();
    assert!(rest.contains("\"error_type\":\"timeout\""), "{rest}");
}

async fn begin(app: &Router) -> Body {
    let request = stream("", BLOCK);
    let response = app.clone().oneshot(request).await.unwrap();
    assert_eq!(response.status(), StatusCode::OK);
    response.into_body()
}

#[tokio::test]
async fn a_reader_that_leaves_stops_the_work() {
    let fake = Fake::new();
    let app = app(&fake, &small_limits());
    let mut body = begin(&app).await;
    let start = body.frame().await.unwrap().unwrap().into_data().unwrap();
    assert!(start.starts_with(b"event: start\n"));
    drop(body);
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    // The work tells so a moment after its end.
    let told = ["bailando_cancelled_total{phase=\"inference\"} 1", "bailando_requests_running 0"];
    until_counted(&app, &told).await;
}

#[tokio::test]
async fn a_slow_reader_keeps_nobody_from_working() {
    let fake = Fake::new();
    let app = app(&fake, &small_limits());
    // It reads the beginning only, and its dance is made meanwhile.
    let mut body = begin(&app).await;
    assert!(body.frame().await.is_some());
    fake.release();
    fake.wait_ended(1).await;
    for _ in 0..3 {
        assert_eq!(send(&app, stream("", b"song")).await.status, StatusCode::OK);
    }
    let rest = body.collect().await.unwrap().to_bytes();
    let rest = String::from_utf8(rest.to_vec()).unwrap();
    // The last byte of an event is a piece of its own.
    assert!(rest.trim_start().starts_with("event: frames\n"));
    assert!(rest.contains("event: done\n"));
}
