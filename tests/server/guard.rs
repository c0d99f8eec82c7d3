//! Nobody takes the service away from the others.

use std::{
    io::{Read, Write},
    net::TcpStream,
    num::NonZeroUsize,
    time::{Duration, Instant},
};

use axum::{Router, body::Body, http::Request};
use bailando::server::{Access, ByteSize, Limits, Seconds};
use tower::ServiceExt;

use super::{
    client::{
        LONG, app, app_for, eventually, get as ask, post, raw, send, spawn, until_counted, with,
    },
    fake::{BLOCK, Fake, LONG_DANCE, LONG_SONG},
    lifecycle::{Server, get, post as song, post_to},
};

const SOON: Duration = Duration::from_millis(400);

/// The figure after `name` in the metrics.
pub(crate) async fn figure(server: &Server, name: &str) -> f64 {
    // Scrapes of the same moment have the same text.
    tokio::time::sleep(Duration::from_millis(150)).await;
    let text = server.expect(get("/metrics"), 200).await;
    let found = text.lines().find_map(|line| line.strip_prefix(name));
    found.map_or(0.0, |figure| figure.trim().parse().unwrap())
}

/// Bytes that are held for readers.
pub(crate) async fn held_answers(server: &Server) -> f64 {
    figure(server, "bailando_answer_bytes ").await
}

/// Orders a job and waits until it is done.
pub(crate) async fn finished_job(server: &Server, audio: &[u8]) -> String {
    let accepted = server.expect(post_to("/jobs", audio), 202).await;
    let location = accepted.lines().find_map(|line| line.strip_prefix("location: "));
    let location = location.unwrap().to_owned();
    eventually("the job is done", async || {
        let status = server.expect(get(&location), 200).await;
        status.contains("\"done\"").then_some(())
    })
    .await;
    location
}

fn request(path: &str) -> Vec<u8> {
    format!("GET {path} HTTP/1.1\r\nHost: x\r\n\r\n").into_bytes()
}

fn connect(server: &Server) -> TcpStream {
    let stream = TcpStream::connect(server.address).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    stream
}

/// Asks for something and reads the first line of the answer only; little fits on the way to it.
async fn begin_to_read(server: &Server, path: &str) -> TcpStream {
    let socket = tokio::net::TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    let mut stream = socket.connect(server.address).await.unwrap().into_std().unwrap();
    stream.set_nonblocking(false).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    stream.write_all(&request(path)).unwrap();
    tokio::task::block_in_place(|| stream.read_exact(&mut [0; 12]).unwrap());
    stream
}

fn count(count: usize) -> NonZeroUsize {
    NonZeroUsize::new(count).unwrap()
}

/// Waits until the server has ended the connection, and gives what it said.
fn ended(mut stream: TcpStream) -> String {
    let mut said = Vec::new();
    let _ = stream.read_to_end(&mut said);
    String::from_utf8_lossy(&said).into_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn many_readers_of_one_result_share_it() {
    let server = Server::start(&Fake::new(), Limits::default()).await;
    let job = finished_job(&server, LONG_DANCE).await;
    // Not as it was ordered, and therefore stored.
    let result = format!("{job}/result?format=bvh");
    let written = "bailando_stage_duration_seconds_count{stage=\"write\"} ";
    let before = figure(&server, written).await;
    let mut readers = Vec::new();
    for _ in 0..40 {
        readers.push(begin_to_read(&server, &result).await);
    }
    assert_eq!(figure(&server, written).await, before + 1.0);
    let one = held_answers(&server).await;
    assert!((1e6..6e6).contains(&one), "{one}");
    drop(readers);
    eventually("nothing is held", async || (held_answers(&server).await == 0.0).then_some(()))
        .await;
}

/// A reader who hangs up while a result is written does not free what the writing needs: the next
/// waits for it.
#[tokio::test(flavor = "multi_thread")]
async fn readers_who_hang_up_do_not_multiply_the_writing() {
    let limits = Limits { max_concurrent_requests: count(1), ..Limits::default() };
    let server = Server::start(&Fake::new(), limits).await;
    let job = finished_job(&server, LONG_DANCE).await;
    for _ in 0..40 {
        let mut stream = connect(&server);
        stream.write_all(&request(&format!("{job}/result"))).unwrap();
        drop(stream);
    }
    let held = held_answers(&server).await;
    assert!(held < 7e6, "{held}");
    server.expect(get(&format!("{job}/result")), 200).await;
    eventually("nothing is held", async || (held_answers(&server).await == 0.0).then_some(()))
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_leaves_its_share_of_answers_unread_is_refused_at_once() {
    let limits = Limits { answer_memory: ByteSize(10_000_000), ..Limits::default() };
    let server = Server::start(&Fake::new(), limits).await;
    let first = finished_job(&server, LONG_DANCE).await;
    let second = finished_job(&server, LONG_DANCE).await;
    let unread = begin_to_read(&server, &format!("{first}/result")).await;
    let started = Instant::now();
    let refused = server.exchange(get(&format!("{second}/result"))).await.unwrap();
    let refused: String = refused.chars().take(2_000).collect();
    assert!(refused.starts_with("HTTP/1.1 429"), "{refused}");
    assert!(refused.contains("answer_memory") && refused.contains("retry-after"), "{refused}");
    assert!(started.elapsed() < Duration::from_secs(5));
    drop(unread);
    eventually("its share is free", async || (held_answers(&server).await == 0.0).then_some(()))
        .await;
    server.expect(get(&format!("{second}/result")), 200).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn idle_connections_make_room() {
    let limits = Limits { max_connections: count(8), ..Limits::default() };
    let server = Server::start(&Fake::new(), limits).await;
    let idle: Vec<_> = (0..30).map(|_| connect(&server)).collect();
    let started = Instant::now();
    server.expect(get("/health"), 200).await;
    assert!(started.elapsed() < Duration::from_secs(5));
    tokio::task::block_in_place(|| ended(idle.into_iter().next().unwrap()));
}

/// Where all connections are busy, probes are answered, and the others are told so.
#[tokio::test(flavor = "multi_thread")]
async fn probes_are_answered_beside_any_number_of_busy_connections() {
    let fake = Fake::new();
    let limits = Limits { max_connections: count(1), ..Limits::default() };
    let server = Server::start(&fake, limits).await;
    let busy = server.exchange(song(BLOCK));
    fake.wait_started(1).await;
    for path in ["/health", "/ready", "/metrics"] {
        server.expect(get(path), 200).await;
    }
    let refused = server.expect(get("/info"), 503).await;
    assert!(
        refused.contains("too_many_connections") && refused.contains("retry-after"),
        "{refused}"
    );
    fake.release();
    assert!(busy.await.unwrap().starts_with("HTTP/1.1 200"));
    server.expect(get("/info"), 200).await;
}

/// Begins an upload of which next to nothing arrives.
fn dribble(server: &Server) -> TcpStream {
    let mut stream = connect(server);
    let head = song(&vec![b'x'; 100_000]);
    stream.write_all(&head[..head.len() - 99_990]).unwrap();
    stream
}

#[tokio::test(flavor = "multi_thread")]
async fn the_slowest_upload_makes_room() {
    let limits = Limits { max_uploads: count(4), ..Limits::default() };
    let server = Server::start(&Fake::new(), limits).await;
    let mut slow: Vec<_> = (0..3).map(|_| dribble(&server)).collect();
    // These three are the share of this client.
    let arrived = async || (figure(&server, "bailando_uploads ").await == 3.0).then_some(());
    eventually("three uploads have begun", arrived).await;
    tokio::time::sleep(Duration::from_millis(1_200)).await;
    server.expect(song(b"song"), 200).await;
    let started = Instant::now();
    while started.elapsed() < LONG {
        for stream in &mut slow {
            stream.set_read_timeout(Some(SOON / 10)).unwrap();
            let mut said = [0; 4096];
            let Ok(length) = tokio::task::block_in_place(|| stream.read(&mut said)) else {
                continue;
            };
            let said = String::from_utf8_lossy(&said[..length]);
            assert!(
                said.starts_with("HTTP/1.1 429") && said.contains("upload_displaced"),
                "{said}"
            );
            return;
        }
    }
    panic!("none of them was displaced");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_that_brings_too_little_is_given_up() {
    let limits = Limits {
        body_idle_timeout: Seconds(SOON),
        body_least_rate: ByteSize(10_000),
        ..Limits::default()
    };
    let server = Server::start(&Fake::new(), limits).await;
    let mut slow = dribble(&server);
    let started = Instant::now();
    let said = tokio::task::block_in_place(|| {
        slow.set_read_timeout(Some(SOON / 10)).unwrap();
        let mut said = [0; 4096];
        loop {
            assert!(started.elapsed() < LONG / 2);
            // Never silent, and never fast.
            let _ = slow.write_all(b"x");
            if let Ok(length) = slow.read(&mut said) {
                return String::from_utf8_lossy(&said[..length]).into_owned();
            }
        }
    });
    assert!(said.starts_with("HTTP/1.1 408") && said.contains("upload_timeout"), "{said}");
}

fn keyed(fake: &std::sync::Arc<Fake>, limits: &Limits) -> Router {
    let keys = ["one", "two"].map(|key| key.parse().unwrap()).to_vec();
    app_for(fake, limits, Access { keys, ..Access::default() })
}

fn of(key: &str, request: Request<Body>) -> Request<Body> {
    with(request, "x-api-key", key)
}

#[tokio::test]
async fn one_client_leaves_workers_to_the_others() {
    let fake = Fake::new();
    let app = keyed(&fake, &Limits::default());
    let many = [(); 6].map(|()| spawn(&app, of("one", raw("", BLOCK))));
    // Three of four workers are its share.
    fake.wait_started(3).await;
    until_counted(&app, &["bailando_queue_waiting 3", "bailando_requests_running 3"]).await;
    let other = send(&app, of("two", raw("", "song"))).await;
    assert_eq!(other.status, 200);
    fake.release();
    for answer in many {
        assert_eq!(answer.await.unwrap().status, 200);
    }
}

#[tokio::test]
async fn long_songs_leave_a_worker_to_short_ones_of_the_same_client() {
    let fake = Fake::new();
    let app = keyed(&fake, &Limits::default());
    // It proves to be long in the worker for short ones only: two of three others are its share.
    let long = ["/generate", "/generate", "/generate", "/generate/stream"];
    let long = long.map(|path| spawn(&app, of("one", post(path, "", LONG_SONG))));
    let said = spawn(&app, of("one", raw("duration_s=21&candidates=3", "song")));
    fake.wait_started(2).await;
    until_counted(&app, &["bailando_queue_waiting 3", "bailando_requests_running 2"]).await;
    for query in ["", "duration_s=20&candidates=3"] {
        assert_eq!(send(&app, of("one", raw(query, "song"))).await.status, 200);
    }
    assert!(!said.is_finished());
    fake.release();
    for answer in long.into_iter().chain([said]) {
        assert_eq!(answer.await.unwrap().status, 200);
    }
}

#[tokio::test]
async fn one_client_leaves_jobs_to_the_others() {
    let fake = Fake::new();
    let limits = Limits { max_jobs: count(4), ..Limits::default() };
    let app = keyed(&fake, &limits);
    for status in [202, 202, 202, 429] {
        let order = send(&app, of("one", post("/jobs", "", BLOCK))).await;
        assert_eq!(order.status, status);
    }
    // One of the two workers for jobs is its share: the other's job runs beside it.
    fake.wait_started(1).await;
    let order = send(&app, of("two", post("/jobs", "", BLOCK))).await;
    assert_eq!(order.status, 202);
    fake.wait_started(1).await;
    fake.release();
}

/// As many streams of events as connections, however many an HTTP/2 connection has.
#[tokio::test]
async fn one_client_leaves_streams_of_events_to_the_others() {
    let fake = Fake::new();
    let limits = Limits { max_connections: count(4), ..Limits::default() };
    let app = keyed(&fake, &limits);
    let mut held = Vec::new();
    let mut follow = async |key: &str, status: u16| {
        let order = send(&app, of(key, post("/jobs", "", BLOCK))).await;
        let path = format!("{}/events", order.header("location"));
        let request = of(key, Request::get(path).body(Body::empty()).unwrap());
        let answer = app.clone().oneshot(request).await.unwrap();
        assert_eq!(answer.status(), status);
        held.push(answer);
    };
    for status in [200, 200, 200, 503] {
        follow("one", status).await;
    }
    follow("two", 200).await;
    follow("two", 503).await;
    held.clear();
    fake.release();
}

#[tokio::test]
async fn one_client_leaves_bytes_for_jobs_to_the_others() {
    let fake = Fake::new();
    let limits = Limits { job_bytes: ByteSize(4_000_000), ..Limits::default() };
    let app = keyed(&fake, &limits);
    // What comes after it waits: it takes the client's share of the workers.
    let short = "duration_s=1";
    assert_eq!(send(&app, of("one", post("/jobs", short, BLOCK))).await.status, 202);
    fake.wait_started(1).await;
    let song = vec![0; 1_000_000];
    for _ in 0..3 {
        let order = send(&app, of("one", post("/jobs", short, song.clone()))).await;
        assert_eq!(order.status, 202);
    }
    let more = send(&app, of("one", post("/jobs", short, song.clone()))).await;
    more.expect_error(503, "job_bytes");
    assert_eq!(send(&app, of("two", post("/jobs", short, song))).await.status, 202);
    fake.release();
}

#[tokio::test]
async fn a_job_has_its_time() {
    let fake = Fake::new();
    let limits = Limits { job_timeout: Seconds(SOON), ..Limits::default() };
    let app = app(&fake, &limits);
    let order = send(&app, post("/jobs", "", BLOCK)).await;
    let job = order.header("location").to_owned();
    let failed = eventually("the job fails", async || {
        let status = ask(&app, &job).await.json();
        (status["state"] == "failed").then_some(status)
    });
    assert_eq!(failed.await["error"]["error_type"], "job_timeout");
    fake.wait_ended(1).await;
    let result = ask(&app, &format!("{job}/result")).await;
    result.expect_error(503, "job_timeout");
}

/// As much as the song needs, and not as the longest would.
#[tokio::test(flavor = "multi_thread")]
async fn a_stream_holds_what_its_song_needs() {
    let fake = Fake::new();
    let server = Server::start(&fake, Limits::default()).await;
    let mut stream = connect(&server);
    stream.write_all(&post_to("/generate/stream", BLOCK)).unwrap();
    fake.wait_started(1).await;
    // A second of sixty frames of nine float32.
    assert_eq!(held_answers(&server).await, 60.0 * 9.0 * 4.0);
    fake.release();
    let said = tokio::task::block_in_place(|| ended(stream));
    assert!(said.contains("event: done"), "{said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_names_one_host() {
    let server = Server::start(&Fake::new(), Limits::default()).await;
    for hosts in ["", "Host: x\r\nHost: y\r\n"] {
        let request = format!("GET /info HTTP/1.1\r\n{hosts}Connection: close\r\n\r\n");
        let refused = server.expect(request.into_bytes(), 400).await;
        assert!(refused.contains("wrong_host") && refused.contains("x-request-id"), "{refused}");
    }
}
