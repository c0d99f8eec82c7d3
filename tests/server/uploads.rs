//! Limits of what is uploaded: bytes of audio, of a form, of all bodies, and time.

use std::{
    convert::Infallible,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use axum::{
    body::Body,
    http::{Request, StatusCode},
};
use bailando::server::{ByteSize, Limits, Seconds};
use bytes::Bytes;
use futures_util::{StreamExt, stream};
use http_body_util::BodyExt;

use crate::server::{
    client::{Answer, app, form, raw, refuse, send, small_limits, succeed, until_counted},
    fake::Fake,
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
        (b"ID3\x04\0\0\0\0\0\x02..fLaC", LOSSLESS),
        (b"ID3\x04\0\0\0\0\0\x02..\xff\xfb\x90\0", LOSSY),
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

const PIECE: usize = 1_000;

/// A body that never ends, and how many pieces of it were taken after `beginning`.
fn endless(beginning: &'static str) -> (Body, Arc<AtomicUsize>) {
    let taken = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&taken);
    let rest = stream::repeat_with(move || {
        counted.fetch_add(1, Ordering::SeqCst);
        Bytes::from_static(&[b'x'; PIECE])
    });
    let first = stream::iter([Bytes::from_static(beginning.as_bytes())]);
    let all = first.chain(rest).map(Ok::<_, Infallible>);
    (Body::from_stream(all), taken)
}

/// A body that is too large is refused at the byte that is too many.
#[tokio::test]
async fn excess_is_not_taken_in() {
    let app = app(&Fake::new(), &byte_limits());
    let (body, taken) = endless("");
    let answer = send(&app, raw("", body)).await;
    // From now on it is thrown away as it comes.
    let taken = taken.load(Ordering::SeqCst);
    answer.expect_error(413, "payload_too_large");
    assert_eq!(taken, LOSSY / PIECE + 1);
}

/// What a form's parser would keep, and search again with every piece, is refused when it gets
/// long.
#[tokio::test]
async fn a_form_holds_little_beside_its_parts() {
    const OVERHEAD: usize = 64 * 1024;
    let app = app(&Fake::new(), &Limits::default());
    let head = "--frontier\r\nContent-Disposition: form-data; name=\"file\"\r\n";
    for beginning in ["no boundary", head] {
        let (body, taken) = endless(beginning);
        let mut request = form("", &[]);
        *request.body_mut() = body;
        let answer = send(&app, request).await;
        let taken = taken.load(Ordering::SeqCst);
        let said = answer.expect_error(400, "invalid_multipart");
        assert!(said.contains("more than 64KiB beside"), "{said}");
        assert!((1..=OVERHEAD / PIECE + 1).contains(&taken), "{taken}");
    }
    // In one piece, and with a song after it.
    let preamble = |length: usize| {
        let mut request = form("", &[]);
        let rest = format!("\r\n{head}\r\nsong\r\n--frontier--\r\n");
        *request.body_mut() = Body::from([vec![b'x'; length], rest.into_bytes()].concat());
        request
    };
    refuse(&app, preamble(1_000_000), 400, "invalid_multipart").await;
    succeed(&app, preamble(OVERHEAD / 2)).await;
}

/// However much of the audio comes together with the options before it, it does not count as
/// theirs.
#[tokio::test]
async fn options_may_come_before_a_large_file() {
    let fake = Fake::new();
    let app = app(&fake, &Limits::default());
    let audio = file(b"fLaC", 2_000_000);
    let parts: [(&str, &[u8]); 8] = [
        ("seed", b"1"),
        ("fps", b"30"),
        ("format", b"json"),
        ("temperature", b"1"),
        ("candidates", b"1"),
        ("music", b"false"),
        ("bvh_unit", b"m"),
        ("file", &audio),
    ];
    let whole = form("", &parts);
    let mut in_pieces = form("", &[]);
    let body = form("", &parts).into_body().collect().await.unwrap();
    *in_pieces.body_mut() = chunked(&body.to_bytes(), 60_000);
    for request in [whole, in_pieces] {
        let answer = send(&app, request).await;
        assert_eq!(answer.status, StatusCode::OK, "{}", answer.json());
        assert_eq!(fake.heard.lock().unwrap().pop().unwrap(), audio);
    }
}

#[tokio::test]
async fn uploads_are_held_within_their_memory() {
    let fake = Fake::new();
    let limits = Limits { upload_memory: ByteSize(8), ..small_limits() };
    let app = app(&fake, &limits);
    refuse(&app, raw("", "nine bytes"), 429, "upload_memory").await;
    succeed(&app, raw("", "8 bytes!")).await;
    succeed(&app, raw("", "8 bytes!")).await;
    // All of a form counts.
    refuse(&app, form("", &[("file", b"8 bytes!")]), 429, "upload_memory").await;
    until_counted(&app, &["bailando_upload_bytes 0"]).await;
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
    let total = Limits { body_idle_timeout: FAR, body_timeout: Seconds(soon), ..idle.clone() };
    let stalled = slow(idle, 3, Duration::from_millis(1));
    let said = stalled.await.expect_error(408, "upload_timeout");
    assert!(said.contains("1kB a second over every 0.3 s are asked, and 3600 s in all"), "{said}");
    let started = Instant::now();
    let dribbling = slow(total, usize::MAX, Duration::from_millis(20));
    dribbling.await.expect_error(408, "upload_timeout");
    assert!(started.elapsed() >= soon);
}
