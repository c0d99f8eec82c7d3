//! Dances that are ordered now and fetched later.

use std::{
    num::NonZeroUsize,
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use axum::{
    Router,
    body::Body,
    http::{Request, StatusCode},
};
use bailando::server::{Limits, Seconds};
use serde_json::Value;

use crate::server::{
    client::{app, eventually, get, post, raw, send, small_limits, until_counted, with},
    fake::{BLOCK, Fake, PANIC},
    lifecycle::{Server, get as get_bytes, post_to},
};

/// Orders a job, and gives the path that it is asked about at.
async fn order(app: &Router, query: &str, audio: &'static [u8]) -> String {
    let accepted = send(app, post("/jobs", query, audio)).await;
    assert_eq!(accepted.status, StatusCode::ACCEPTED, "{}", accepted.json());
    let path = accepted.header("location").to_owned();
    assert_eq!(path, format!("/jobs/{}", accepted.json()["id"].as_str().unwrap()));
    path
}

/// Asks until the job is no longer in one of `states`.
async fn after(app: &Router, path: &str, states: &[&str]) -> Value {
    let what = format!("a job is no longer {states:?}");
    eventually(&what, async || {
        let status = get(app, path).await.json();
        let left = !states.contains(&status["state"].as_str().unwrap());
        left.then_some(status)
    })
    .await
}

async fn delete(app: &Router, path: &str) -> StatusCode {
    let request = Request::delete(path).body(Body::empty()).unwrap();
    send(app, request).await.status
}

#[tokio::test]
async fn a_job_is_ordered_asked_about_fetched_and_deleted() {
    let fake = Fake::new();
    let app = app(&fake, &Limits::default());
    let path = order(&app, "seed=4", BLOCK).await;
    fake.wait_started(1).await;
    let running = after(&app, &path, &["queued"]).await;
    assert_eq!((&running["state"], &running["stage"]), (&"running".into(), &"decode".into()));
    let early = get(&app, &format!("{path}/result")).await;
    let said = early.expect_error(409, "job_not_done");
    assert!(said.contains("it is running"), "{said}");
    fake.release();
    let done = after(&app, &path, &["running"]).await;
    assert_eq!(done["state"], "done");
    assert_eq!((&done["codes_done"], &done["codes_total"]), (&1.into(), &1.into()));
    let result = done["result"].as_str().unwrap();
    let json = get(&app, result).await;
    assert_eq!((json.status, &json.json()["seed"]), (StatusCode::OK, &4.into()));
    let bvh = get(&app, &format!("{result}?format=bvh&bvh_unit=m")).await;
    assert!(bvh.body.starts_with(b"HIERARCHY"));
    assert_eq!(bvh.header("x-seed"), "4");
    let glb = get(&app, &format!("{result}?format=glb&mannequin=false")).await;
    assert!(glb.body.starts_with(b"glTF"));
    let another = get(&app, &format!("{result}?seed=5")).await;
    let said = another.expect_error(400, "invalid_option");
    assert!(said.contains("the motion exists already"), "{said}");
    assert_eq!(delete(&app, &path).await, StatusCode::NO_CONTENT);
    get(&app, &path).await.expect_error(404, "no_such_job");
    assert_eq!(delete(&app, &path).await, StatusCode::NOT_FOUND);
    get(&app, "/jobs/no-id").await.expect_error(404, "no_such_job");
}

/// As a browser's `EventSource` follows it.
#[tokio::test]
async fn a_job_is_followed_to_its_end() {
    let fake = Fake::new();
    let app = app(&fake, &Limits::default());
    let path = order(&app, "", BLOCK).await;
    fake.wait_started(1).await;
    let following = tokio::spawn({
        let (app, path) = (app.clone(), path.clone());
        async move { get(&app, &format!("{path}/events")).await }
    });
    fake.release();
    let events = following.await.unwrap();
    assert_eq!(events.header("content-type"), "text/event-stream");
    assert_eq!(events.header("x-accel-buffering"), "no");
    assert!(events.header("cache-control").contains("no-transform"));
    let text = String::from_utf8(events.body).unwrap();
    let names: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("event: ")).collect();
    let (last, before) = names.split_last().unwrap();
    assert!(*last == "done" && before.iter().all(|name| *name == "progress"), "{text}");
    assert!(text.contains("\nid: end\ndata: {") && text.contains("\"state\":\"done\""), "{text}");
    let mut again = Request::get(format!("{path}/events")).body(Body::empty()).unwrap();
    again.headers_mut().insert("last-event-id", "end".parse().unwrap());
    assert_eq!(send(&app, again).await.status, StatusCode::NO_CONTENT);
    get(&app, "/jobs/no-id/events").await.expect_error(404, "no_such_job");
}

/// The option wins, then what the header prefers, then what was ordered.
#[tokio::test]
async fn a_result_comes_as_it_is_asked_for() {
    const JSON: &str = "application/json";
    const BVH: &str = "application/x-bvh";
    let app = app(&Fake::new(), &Limits::default());
    let path = order(&app, "format=bvh", b"song").await;
    after(&app, &path, &["queued", "running"]).await;
    let ask = async |query: &str, accept: Option<&'static str>| {
        let mut request = Request::get(format!("{path}/result{query}"));
        if let Some(accept) = accept {
            request = request.header("accept", accept);
        }
        send(&app, request.body(Body::empty()).unwrap()).await
    };
    for (query, accept, wanted) in [
        ("", None, BVH),
        ("", Some("*/*"), BVH),
        ("", Some("application/*"), BVH),
        ("", Some(JSON), JSON),
        ("?format=bvh", Some(JSON), BVH),
        ("?format=json", None, JSON),
        ("?format=json", Some("image/png"), JSON),
    ] {
        let answer = ask(query, accept).await;
        assert_eq!(
            (answer.status, answer.header("content-type")),
            (StatusCode::OK, wanted),
            "{query} {accept:?}"
        );
    }
    let picture = ask("", Some("image/png")).await;
    picture.expect_error(406, "not_acceptable");
}

/// A new job takes the place of one that was fetched, but of no other.
#[tokio::test]
async fn who_has_its_dance_makes_room() {
    let limits = Limits { max_jobs: NonZeroUsize::MIN, ..Limits::default() };
    let app = app(&Fake::new(), &limits);
    let first = order(&app, "", b"song").await;
    after(&app, &first, &["queued", "running"]).await;
    let one_more = send(&app, post("/jobs", "", "song")).await;
    one_more.expect_error(429, "too_many_jobs");
    let fetched = get(&app, &format!("{first}/result")).await;
    assert_eq!(fetched.status, StatusCode::OK);
    let second = order(&app, "", b"song").await;
    get(&app, &first).await.expect_error(404, "no_such_job");
    assert_eq!(get(&app, &second).await.status, StatusCode::OK);
    let jobs = ["bailando_jobs{state=\"done\"} 1"];
    until_counted(&app, &jobs).await;
}

#[tokio::test]
async fn a_job_that_fails_says_why() {
    let app = app(&Fake::new(), &Limits::default());
    let path = order(&app, "", PANIC).await;
    let failed = after(&app, &path, &["queued", "running"]).await;
    assert_eq!(failed["state"], "failed");
    assert_eq!(failed["error"]["error_type"], "internal");
    let result = get(&app, &format!("{path}/result")).await;
    result.expect_error(500, "internal");
    let wrong = send(&app, post("/jobs", "fps=1", "song")).await;
    wrong.expect_error(400, "invalid_option");
}

#[tokio::test]
async fn a_deleted_job_stops_its_work() {
    let fake = Fake::new();
    let app = app(&fake, &small_limits());
    let running = order(&app, "", BLOCK).await;
    fake.wait_started(1).await;
    let queued = order(&app, "", BLOCK).await;
    assert_eq!(get(&app, &queued).await.json()["state"], "queued");
    assert_eq!(delete(&app, &queued).await, StatusCode::NO_CONTENT);
    assert_eq!(delete(&app, &running).await, StatusCode::NO_CONTENT);
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    assert_eq!(send(&app, raw("", "song")).await.status, StatusCode::OK);
    assert_eq!(fake.generations.load(Ordering::SeqCst), 2);
}

/// Each job in memory is waited for by one task, however often it is ordered again.
#[tokio::test]
async fn an_order_that_is_sent_again_leaves_nothing_behind() {
    let app = app(&Fake::new(), &Limits::default());
    let ordered = async || {
        let keyed = with(post("/jobs", "", "song"), "idempotency-key", "one");
        let accepted = send(&app, keyed).await;
        assert_eq!(accepted.status, StatusCode::ACCEPTED, "{}", accepted.json());
        accepted
    };
    let path = ordered().await.header("location").to_owned();
    after(&app, &path, &["queued", "running"]).await;
    for _ in 0..50 {
        assert_eq!(ordered().await.header("idempotency-replayed"), "true");
    }
    let tasks = || tokio::runtime::Handle::current().metrics().num_alive_tasks();
    eventually("no task is left of them", async || (tasks() < 50).then_some(())).await;
}

#[tokio::test]
async fn jobs_are_bounded_and_leave_places_for_others() {
    let fake = Fake::new();
    let limits = Limits {
        max_concurrent_requests: NonZeroUsize::new(2).unwrap(),
        max_jobs: NonZeroUsize::new(3).unwrap(),
        job_ttl: Seconds(Duration::from_millis(200)),
        ..Limits::default()
    };
    let app = app(&fake, &limits);
    for _ in 0..3 {
        order(&app, "", BLOCK).await;
    }
    let one_more = send(&app, post("/jobs", "", "song")).await;
    one_more.expect_error(429, "too_many_jobs");
    // Only one of them runs: there is a place for who waits.
    fake.wait_started(1).await;
    assert_eq!(send(&app, raw("", "song")).await.status, StatusCode::OK);
    fake.release();
    fake.wait_ended(4).await;
    tokio::time::sleep(limits.job_ttl.0 * 2).await;
    order(&app, "", b"song").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_stops_ends_its_jobs_and_waits_for_who_asks() {
    let fake = Fake::new();
    let server = Server::start(&fake, small_limits()).await;
    let accepted = server.expect(post_to("/jobs", BLOCK), 202).await;
    let location =
        accepted.lines().find_map(|line| line.strip_prefix("location: ")).unwrap().to_owned();
    fake.wait_started(1).await;
    server.stop();
    server.until_ready_says("HTTP/1.1 503").await;
    server.expect(post_to("/jobs", b"song"), 503).await;
    fake.release();
    eventually("the job is done", async || {
        let status = server.expect(get_bytes(&location), 200).await;
        status.contains("\"done\"").then_some(())
    })
    .await;
    let result = get_bytes(&format!("{location}/result"));
    let result = server.expect(result, 200).await;
    assert!(result.contains("\"positions\""), "{result}");
    let fetched = Instant::now();
    server.task.await.unwrap().unwrap();
    assert!(fetched.elapsed() < Duration::from_secs(4));
    assert_eq!(Arc::strong_count(&fake), 1);
}
