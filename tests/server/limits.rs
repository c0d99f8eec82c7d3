//! Limits of size, time and number.

use std::{
    convert::Infallible,
    num::{NonZeroU32, NonZeroUsize},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use axum::{
    body::Body,
    http::{HeaderValue, Request, StatusCode, header},
};
use bailando::server::{ByteSize, Limits, Seconds};
use bytes::Bytes;
use futures_util::{StreamExt, stream};
use tokio::task::JoinSet;

use crate::{
    client::{Answer, app, form, get, raw, send, small_limits},
    fake::{BLOCK, Fake},
};

const LOSSY: usize = 5_000;
const LOSSLESS: usize = 100_000;

fn byte_limits() -> Limits {
    Limits {
        payload_limit: ByteSize(LOSSY as u64),
        payload_limit_lossless: ByteSize(LOSSLESS as u64),
        ..Limits::default()
    }
}

/// `len` bytes that begin with `magic`.
fn file(magic: &[u8], len: usize) -> Vec<u8> {
    let mut bytes = magic.to_vec();
    bytes.resize(len, 1);
    bytes
}

/// A body without a length, in pieces of `piece` bytes.
fn chunked(bytes: &[u8], piece: usize) -> Body {
    let pieces: Vec<_> = bytes
        .chunks(piece)
        .map(|piece| Ok::<_, Infallible>(Bytes::copy_from_slice(piece)))
        .collect();
    Body::from_stream(stream::iter(pieces))
}

/// The same audio in every way that it can be sent.
fn ways(audio: &[u8]) -> Vec<(&'static str, Request<Body>)> {
    let form_bytes = || form("", &[("file", audio)]);
    let chunked_form = |piece: usize| {
        let mut request = form("", &[]);
        let body = [
            &b"--frontier\r\nContent-Disposition: form-data; name=\"file\"\r\n\r\n"[..],
            audio,
            b"\r\n--frontier--\r\n",
        ]
        .concat();
        *request.body_mut() = chunked(&body, piece);
        request
    };
    vec![
        ("raw", raw("", audio.to_vec())),
        ("raw in pieces", raw("", chunked(audio, 1_000))),
        ("raw in small pieces", raw("", chunked(audio, 5))),
        ("form", form_bytes()),
        ("form in pieces", chunked_form(1_000)),
        ("form in small pieces", chunked_form(7)),
    ]
}

#[tokio::test]
async fn a_file_may_have_exactly_its_limit() {
    let fake = Fake::new();
    let app = app(&fake, &byte_limits());
    for (magic, limit) in [
        (&b"ID3"[..], LOSSY),
        (b"fLaC", LOSSLESS),
        (b"RIFF\x01\x02\x03\x04WAVE", LOSSLESS),
        (b"RIFF\x01\x02\x03\x04AVI ", LOSSY),
    ] {
        for len in [limit - 1, limit, limit + 1] {
            let audio = file(magic, len);
            for (way, request) in ways(&audio) {
                let answer = send(&app, request).await;
                if len <= limit {
                    assert_eq!(answer.status, StatusCode::OK, "{way}: {len}");
                    assert_eq!(fake.heard.lock().unwrap().pop().unwrap(), audio, "{way}");
                } else {
                    let said = answer.expect_error(413, "payload_too_large");
                    assert!(
                        said.contains(&format!("larger than {}:", ByteSize(limit as u64))),
                        "{way}: {said}"
                    );
                }
            }
        }
    }
}

/// A body that is too large is refused at the byte that is too many: this one never ends.
#[tokio::test]
async fn excess_is_not_taken_in() {
    let app = app(&Fake::new(), &byte_limits());
    let polled = Arc::new(std::sync::atomic::AtomicUsize::new(0));
    let counted = {
        let polled = Arc::clone(&polled);
        stream::repeat_with(move || {
            polled.fetch_add(1, Ordering::SeqCst);
            Ok::<_, Infallible>(Bytes::from_static(&[7; 1_000]))
        })
        .take(LOSSY / 1_000 + 1)
        .chain(stream::pending())
    };
    let answer = send(&app, raw("", Body::from_stream(counted))).await;
    answer.expect_error(413, "payload_too_large");
    assert!(polled.load(Ordering::SeqCst) <= LOSSY / 1_000 + 1);
}

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
    assert_eq!(send(&app, raw("", "song")).await.status, StatusCode::OK);
}

/// A body that says whether anything of it was read, and never ends.
fn watched() -> (Body, Arc<AtomicBool>) {
    let read = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&read);
    let first = stream::once(async move {
        told.store(true, Ordering::SeqCst);
        Ok::<_, Infallible>(Bytes::from_static(b"song"))
    });
    (Body::from_stream(first.chain(stream::pending())), read)
}

/// The permit comes before the body: what nobody can use is not read.
#[tokio::test]
async fn no_body_is_read_without_a_permit() {
    let fake = Fake::new();
    let limits = Limits {
        max_uploads: NonZeroUsize::MIN,
        ..small_limits()
    };
    let app = app(&fake, &limits);
    // While one upload is on its way, another is refused.
    let (slow, slow_read) = watched();
    let uploading = tokio::spawn({
        let app = app.clone();
        async move { send(&app, raw("", slow)).await }
    });
    while !slow_read.load(Ordering::SeqCst) {
        tokio::task::yield_now().await;
    }
    let (body, read) = watched();
    let refused = send(&app, raw("", body)).await;
    refused.expect_error(429, "too_many_uploads");
    assert!(!read.load(Ordering::SeqCst));
    uploading.abort();
    assert!(uploading.await.unwrap_err().is_cancelled());
    // And so it is where the line is full.
    let mut blocked = JoinSet::new();
    for _ in 0..2 {
        let app = app.clone();
        blocked.spawn(async move { send(&app, raw("", BLOCK)).await });
        fake.wait_started(u32::from(blocked.len() == 1)).await;
        for _ in 0..100 {
            tokio::task::yield_now().await;
        }
    }
    let (body, read) = watched();
    let refused = send(&app, raw("", body)).await;
    refused.expect_error(429, "queue_full");
    assert!(!read.load(Ordering::SeqCst));
    fake.release();
    for answer in blocked.join_all().await {
        assert_eq!(answer.status, StatusCode::OK);
    }
}

/// A slow upload takes no place to work in: others work meanwhile.
#[tokio::test]
async fn a_slow_upload_keeps_nobody_from_working() {
    let fake = Fake::new();
    let app = app(&fake, &small_limits());
    let (slow, read) = watched();
    let uploading = tokio::spawn({
        let app = app.clone();
        async move { send(&app, raw("", slow)).await }
    });
    while !read.load(Ordering::SeqCst) {
        tokio::task::yield_now().await;
    }
    for _ in 0..3 {
        assert_eq!(send(&app, raw("", "song")).await.status, StatusCode::OK);
    }
    uploading.abort();
}

#[tokio::test]
async fn uploads_are_held_within_their_memory() {
    let fake = Fake::new();
    let limits = Limits {
        upload_memory: ByteSize(8),
        ..small_limits()
    };
    let app = app(&fake, &limits);
    let refused = send(&app, raw("", "nine bytes")).await;
    refused.expect_error(429, "upload_memory");
    assert_eq!(send(&app, raw("", "8 bytes!")).await.status, StatusCode::OK);
    assert_eq!(send(&app, raw("", "8 bytes!")).await.status, StatusCode::OK);
}

#[tokio::test]
async fn a_client_that_asks_too_often_is_told_when_to_come_back() {
    let fake = Fake::new();
    let limits = Limits {
        rate_limit: NonZeroU32::new(1),
        rate_burst: NonZeroU32::new(2).unwrap(),
        ..small_limits()
    };
    let app = app(&fake, &limits);
    for _ in 0..2 {
        assert_eq!(send(&app, raw("", "song")).await.status, StatusCode::OK);
    }
    let refused = send(&app, raw("", "song")).await;
    refused.expect_error(429, "rate_limited");
    let wait: u64 = refused.header("retry-after").parse().unwrap();
    assert!((30..=60).contains(&wait), "{wait}");
    // Probes are no work.
    for path in ["/health", "/ready", "/info", "/metrics"] {
        assert_eq!(get(&app, path).await.status, StatusCode::OK);
    }
}

#[tokio::test]
async fn work_that_takes_too_long_is_stopped() {
    let fake = Fake::new();
    let limits = Limits {
        // Short, but long enough for the song that is danced to afterwards.
        request_timeout: Seconds::new(1),
        ..small_limits()
    };
    let app = app(&fake, &limits);
    let answer = send(&app, raw("", BLOCK)).await;
    answer.expect_error(503, "timeout");
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    assert_eq!(send(&app, raw("", "song")).await.status, StatusCode::OK);
}

#[tokio::test]
async fn a_client_that_leaves_stops_its_work() {
    let fake = Fake::new();
    let app = app(&fake, &small_limits());
    let request = tokio::spawn({
        let app = app.clone();
        async move { send(&app, raw("", BLOCK)).await }
    });
    fake.wait_started(1).await;
    request.abort();
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    assert_eq!(send(&app, raw("", "song")).await.status, StatusCode::OK);
}

/// Nothing is waited for and nothing is read where no answer would be accepted.
#[tokio::test]
async fn a_wrong_accept_header_costs_no_permit() {
    let fake = Fake::new();
    let limits = Limits {
        queue: 0,
        ..small_limits()
    };
    let app = app(&fake, &limits);
    let running = tokio::spawn({
        let app = app.clone();
        async move { send(&app, raw("", BLOCK)).await }
    });
    fake.wait_started(1).await;
    let ask = async |mut request: Request<Body>| {
        let picture = HeaderValue::from_static("image/png");
        request.headers_mut().insert(header::ACCEPT, picture);
        send(&app, request).await
    };
    let endless = Body::from_stream(stream::pending::<Result<Bytes, Infallible>>());
    ask(raw("", endless))
        .await
        .expect_error(406, "not_acceptable");
    // An explicit format wins over the header, and the form's may still come.
    let parts: [(&str, &[u8]); 1] = [("file", b"song")];
    for request in [raw("format=bvh", "song"), form("", &parts)] {
        ask(request).await.expect_error(429, "queue_full");
    }
    fake.release();
    assert_eq!(running.await.unwrap().status, StatusCode::OK);
    ask(form("", &parts))
        .await
        .expect_error(406, "not_acceptable");
}

async fn slow(limits: Limits, pieces: usize, every: Duration) -> Answer {
    let body = stream::unfold(0, move |sent| async move {
        if sent == pieces {
            std::future::pending::<()>().await;
        }
        tokio::time::sleep(every).await;
        Some((Ok::<_, Infallible>(Bytes::from_static(b"x")), sent + 1))
    });
    let app = app(&Fake::new(), &limits);
    send(&app, raw("", Body::from_stream(body.boxed()))).await
}

/// In each case the other clock is set so far that only the one in question can have ended it.
#[tokio::test]
async fn slow_bodies_are_dropped() {
    const FAR: Seconds = Seconds::new(3_600);
    let soon = Duration::from_millis(300);
    let idle = Limits {
        body_idle_timeout: Seconds(soon),
        body_timeout: FAR,
        request_timeout: FAR,
        ..Limits::default()
    };
    let total = Limits {
        body_idle_timeout: FAR,
        body_timeout: Seconds(soon),
        ..idle.clone()
    };
    let stalled = slow(idle, 3, Duration::from_millis(1));
    let said = stalled.await.expect_error(408, "upload_timeout");
    assert!(
        said.contains("0.3 s without data and 3600 s in all"),
        "{said}"
    );
    let started = Instant::now();
    let dribbling = slow(total, usize::MAX, Duration::from_millis(20));
    dribbling.await.expect_error(408, "upload_timeout");
    assert!(started.elapsed() >= soon);
}
