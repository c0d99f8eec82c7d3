//! Limits of number and time, and what requests hold meanwhile.

use std::{
    convert::Infallible,
    num::{NonZeroU32, NonZeroUsize},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use axum::{
    body::Body,
    http::{Request, StatusCode},
};
use bailando::server::{ByteSize, Limits, Seconds};
use bytes::Bytes;
use futures_util::{StreamExt, stream};
use tokio::task::JoinSet;
use tower::ServiceExt;

use crate::server::{
    client::{
        Answer, app, eventually, form, get, post, raw, refuse, send, small_limits, spawn, succeed,
        until_counted, with,
    },
    fake::{BLOCK, Fake},
};

#[tokio::test]
async fn a_full_queue_is_answered_at_once_and_probes_still_pass() {
    let fake = Fake::new();
    let app = app(&fake, &small_limits());
    let mut requests = JoinSet::new();
    let mut ask = || {
        let app = app.clone();
        requests.spawn(async move { send(&app, raw("", BLOCK)).await });
    };
    ask();
    fake.wait_started(1).await;
    ask();
    ask();
    // One of the two waits until it is let go, so the first to end is the other.
    let refused = requests.join_next().await.unwrap().unwrap();
    refused.expect_error(429, "queue_full");
    for path in ["/health", "/ready", "/info"] {
        assert_eq!(get(&app, path).await.status, StatusCode::OK);
    }
    fake.release();
    for answer in requests.join_all().await {
        assert_eq!(answer.status, StatusCode::OK);
    }
    succeed(&app, raw("", "song")).await;
}

/// Returns a body that never ends, and whether any of it was read.
fn watched() -> (Body, Arc<AtomicBool>) {
    let read = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&read);
    let first = stream::once(async move {
        told.store(true, Ordering::SeqCst);
        Ok::<_, Infallible>(Bytes::from_static(b"song"))
    });
    (Body::from_stream(first.chain(stream::pending())), read)
}

async fn until_read(read: &AtomicBool) {
    let read = async || read.load(Ordering::SeqCst).then_some(());
    eventually("a body is read", read).await;
}

/// The permit comes before the body: a body without a permit is not read.
#[tokio::test]
async fn no_body_is_read_without_a_permit() {
    let fake = Fake::new();
    let limits = Limits { max_uploads: NonZeroUsize::MIN, ..small_limits() };
    let app = app(&fake, &limits);
    // While one upload is on its way, another is refused.
    let (slow, slow_read) = watched();
    let uploading = spawn(&app, raw("", slow));
    until_read(&slow_read).await;
    let (body, read) = watched();
    refuse(&app, raw("", body), 429, "too_many_uploads").await;
    assert!(!read.load(Ordering::SeqCst));
    uploading.abort();
    assert!(uploading.await.unwrap_err().is_cancelled());
    // Nor is a body read while the queue is full.
    let blocked = [(); 2].map(|()| spawn(&app, raw("", BLOCK)));
    fake.wait_started(1).await;
    until_counted(&app, &["bailando_queue_waiting 1"]).await;
    let (body, read) = watched();
    refuse(&app, raw("", body), 429, "queue_full").await;
    assert!(!read.load(Ordering::SeqCst));
    fake.release();
    for answer in blocked {
        assert_eq!(answer.await.unwrap().status, StatusCode::OK);
    }
    // Nor when the model has stopped.
    fake.stopped.store(true, Ordering::SeqCst);
    let (body, read) = watched();
    refuse(&app, raw("", body), 503, "model_stopped").await;
    assert!(!read.load(Ordering::SeqCst));
}

/// A slow upload takes no worker.
#[tokio::test]
async fn a_slow_upload_takes_no_worker() {
    let fake = Fake::new();
    let app = app(&fake, &small_limits());
    let (slow, read) = watched();
    let uploading = spawn(&app, raw("", slow));
    until_read(&read).await;
    for _ in 0..3 {
        succeed(&app, raw("", "song")).await;
    }
    uploading.abort();
}

#[tokio::test]
async fn answers_are_held_within_their_memory() {
    let limits = Limits {
        answer_memory: ByteSize(1),
        // A response waits for memory for half of it.
        request_timeout: Seconds::new(4),
        ..small_limits()
    };
    let app = app(&Fake::new(), &limits);
    let untaken = app.clone().oneshot(raw("", "song")).await.unwrap();
    assert_eq!(untaken.status(), StatusCode::OK);
    refuse(&app, raw("", "song"), 503, "answer_memory").await;
    drop(untaken);
    succeed(&app, raw("", "song")).await;
}

#[tokio::test]
async fn a_song_waits_for_its_seconds() {
    let fake = Fake::new();
    let limits = Limits {
        max_concurrent_requests: NonZeroUsize::new(2).unwrap(),
        audio_seconds_in_flight: 600.0,
        ..small_limits()
    };
    let app = app(&fake, &limits);
    let requests = [(); 2].map(|()| spawn(&app, raw("", BLOCK)));
    // Both have a worker, and all seconds are taken.
    let taken = ["bailando_requests_running 2", "bailando_audio_seconds_in_flight 600"];
    until_counted(&app, &taken).await;
    fake.wait_started(1).await;
    assert_eq!(fake.generations.load(Ordering::SeqCst), 1);
    fake.release();
    for answer in requests {
        assert_eq!(answer.await.unwrap().status, StatusCode::OK);
    }
}

/// In the header and in the JSON alike, for a queued request and for a job.
#[tokio::test]
async fn the_time_in_the_queue_is_reported() {
    const WAIT: Duration = Duration::from_millis(30);
    let fake = Fake::new();
    let app = app(&fake, &small_limits());
    let told = |answer: &Answer| {
        let queue = answer.json()["timings_ms"]["queue"].as_f64().unwrap();
        assert_eq!(answer.header("x-queue-time").parse(), Ok(queue));
        Duration::from_secs_f64(queue / 1e3)
    };
    let running = spawn(&app, raw("", BLOCK));
    fake.wait_started(1).await;
    let queued = spawn(&app, raw("", "song"));
    let job = send(&app, post("/jobs", "", "song")).await;
    until_counted(&app, &["bailando_queue_waiting 1"]).await;
    eventually("the job waits for a worker", async || {
        let status = get(&app, job.header("location")).await.json();
        (status["stage"] == "queue").then_some(())
    })
    .await;
    tokio::time::sleep(WAIT).await;
    fake.release();
    assert!(told(&running.await.unwrap()) < WAIT);
    assert!(told(&queued.await.unwrap()) >= WAIT);
    let result = format!("{}/result", job.header("location"));
    let fetched = eventually("the job is done", async || {
        let answer = get(&app, &result).await;
        (answer.status != StatusCode::CONFLICT).then_some(answer)
    });
    assert!(told(&fetched.await) >= WAIT);
}

#[tokio::test]
async fn a_client_above_the_rate_limit_is_told_when_to_retry() {
    let fake = Fake::new();
    let limits = Limits {
        rate_limit: NonZeroU32::new(1),
        rate_burst: NonZeroU32::new(2).unwrap(),
        ..small_limits()
    };
    let app = app(&fake, &limits);
    for _ in 0..2 {
        succeed(&app, raw("", "song")).await;
    }
    let refused = send(&app, raw("", "song")).await;
    refused.expect_error(429, "rate_limited");
    let wait: u64 = refused.header("retry-after").parse().unwrap();
    assert!((30..=60).contains(&wait), "{wait}");
    // Probes are not limited.
    for path in ["/health", "/ready", "/info", "/metrics"] {
        assert_eq!(get(&app, path).await.status, StatusCode::OK);
    }
}

#[tokio::test]
async fn work_that_takes_too_long_is_stopped() {
    let fake = Fake::new();
    let limits = Limits {
        // Short, but long enough for the song afterwards.
        request_timeout: Seconds::new(1),
        ..small_limits()
    };
    let app = app(&fake, &limits);
    let answer = send(&app, raw("", BLOCK)).await;
    answer.expect_error(503, "timeout");
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    succeed(&app, raw("", "song")).await;
}

#[tokio::test]
async fn a_client_that_disconnects_stops_its_work() {
    let fake = Fake::new();
    let app = app(&fake, &small_limits());
    let request = spawn(&app, raw("", BLOCK));
    fake.wait_started(1).await;
    request.abort();
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    succeed(&app, raw("", "song")).await;
}

/// A request whose response would not be accepted is refused before it waits or is read.
#[tokio::test]
async fn a_wrong_accept_header_costs_no_permit() {
    let fake = Fake::new();
    let limits = Limits { queue: 0, ..small_limits() };
    let app = app(&fake, &limits);
    let running = spawn(&app, raw("", BLOCK));
    fake.wait_started(1).await;
    let picture = |request: Request<Body>| with(request, "accept", "image/png");
    let endless = Body::from_stream(stream::pending::<Result<Bytes, Infallible>>());
    refuse(&app, picture(raw("", endless)), 406, "not_acceptable").await;
    // An explicit format wins over the header, and the form's may still come.
    let parts: [(&str, &[u8]); 1] = [("file", b"song")];
    for request in [raw("format=bvh", "song"), form("", &parts)] {
        refuse(&app, picture(request), 429, "queue_full").await;
    }
    fake.release();
    assert_eq!(running.await.unwrap().status, StatusCode::OK);
    refuse(&app, picture(form("", &parts)), 406, "not_acceptable").await;
}
