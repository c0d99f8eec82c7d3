//! HTTP/2 clients that take nothing, or say nothing.

use std::{
    io::{Read, Write},
    net::TcpStream,
    time::{Duration, Instant},
};

use bailando::server::{Limits, Seconds};

use super::{
    client::LONG,
    fake::{Fake, LONG_DANCE},
    guard::{figure, finished_job, held_answers},
    lifecycle::{Server, get},
};

const SOON: Duration = Duration::from_millis(400);
const HEADERS: u8 = 1;
const RESET: u8 = 3;
const PING: u8 = 6;
const AWAY: u8 = 7;

/// A client that speaks as much HTTP/2 as it needs (RFC 9113; header blocks of RFC 7541).
pub(crate) struct Http2(pub(crate) TcpStream);

impl Http2 {
    /// Lets the server send so many bytes of each answer.
    pub(crate) fn connect(server: &Server, window: u32) -> Self {
        let mut stream = TcpStream::connect(server.address).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        let mut settings = [0, 0, 6, 4, 0, 0, 0, 0, 0, 0, 4, 0, 0, 0, 0];
        settings[11..].copy_from_slice(&window.to_be_bytes());
        let hello = [b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".as_slice(), &settings].concat();
        stream.write_all(&hello).unwrap();
        Self(stream)
    }

    pub(crate) fn frame(&mut self, kind: u8, flags: u8, stream: u32, payload: &[u8]) {
        let length = u32::try_from(payload.len()).unwrap().to_be_bytes();
        let stream = stream.to_be_bytes();
        let head = [&length[1..], &[kind, flags], &stream].concat();
        self.0.write_all(&[&head, payload].concat()).unwrap();
    }

    /// The header block of a GET.
    pub(crate) fn block(path: &str) -> Vec<u8> {
        let length = u8::try_from(path.len()).unwrap();
        // :method GET and :scheme http of the static table, :path and :authority as they are.
        [&[0x82, 0x86, 0x04, length], path.as_bytes(), &[0x01, 1, b'x']].concat()
    }

    pub(crate) fn get(&mut self, stream: u32, path: &str) {
        self.frame(HEADERS, 5, stream, &Self::block(path));
    }

    /// Reads until a frame of `kind`, answering pings; false where the connection ends first.
    pub(crate) fn until(&mut self, kind: u8) -> bool {
        let mut head = [0; 9];
        while self.0.read_exact(&mut head).is_ok() {
            let length = u32::from_be_bytes([0, head[0], head[1], head[2]]);
            let mut payload = vec![0; length as usize];
            if self.0.read_exact(&mut payload).is_err() {
                return false;
            }
            if head[3] == kind {
                return true;
            }
            if head[3] == PING && head[4] & 1 == 0 {
                self.frame(PING, 1, 0, &payload);
            }
        }
        false
    }
}

fn patient_for(time: Duration) -> Limits {
    Limits { answer_idle_timeout: Seconds(time), ..Limits::default() }
}

/// A stream whose client takes a byte of it, or none, is reset, and nothing is held for it any
/// more, though its connection lives on.
#[tokio::test(flavor = "multi_thread")]
async fn a_stream_that_is_not_taken_is_reset() {
    let fake = Fake::new();
    let server = Server::start(&fake, patient_for(SOON)).await;
    let job = finished_job(&server, LONG_DANCE).await;
    let result = format!("{job}/result");
    for (window, path) in [(0, &*result), (1, &*result), (1, "/api-doc/openapi.json")] {
        let mut client = Http2::connect(&server, window);
        client.get(1, path);
        tokio::task::block_in_place(|| assert!(client.until(HEADERS), "{path}"));
        if path == result {
            assert!(held_answers(&server).await > 1_000_000.0, "{path}");
        }
        let started = Instant::now();
        tokio::task::block_in_place(|| assert!(client.until(RESET), "{path}"));
        assert!(started.elapsed() < LONG / 2);
        assert_eq!(held_answers(&server).await, 0.0, "{path}");
        client.get(3, "/health");
        tokio::task::block_in_place(|| assert!(client.until(HEADERS), "{path}"));
    }
}

/// Readers that take nothing are no reason to cut off the others at the end.
#[tokio::test(flavor = "multi_thread")]
async fn a_reader_that_takes_nothing_does_not_hold_the_drain() {
    let fake = Fake::new();
    let limits = Limits { shutdown_timeout: Seconds::new(6), ..patient_for(LONG * 4) };
    let server = Server::start(&fake, limits).await;
    let job = finished_job(&server, LONG_DANCE).await;
    let mut client = Http2::connect(&server, 1);
    client.get(1, &format!("{job}/result"));
    tokio::task::block_in_place(|| assert!(client.until(HEADERS)));
    server.stop();
    server.task.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_without_requests_ends_in_good_order() {
    let limits = Limits { connection_idle_timeout: Seconds(SOON), ..Limits::default() };
    let server = Server::start(&Fake::new(), limits).await;
    let mut client = Http2::connect(&server, 65_535);
    let started = Instant::now();
    tokio::task::block_in_place(|| {
        assert!(client.until(AWAY));
        assert!(!client.until(AWAY) || !client.until(AWAY), "the connection ends");
    });
    assert!((SOON / 2..LONG / 2).contains(&started.elapsed()));
    server.expect(get("/health"), 200).await;
    assert!(figure(&server, "bailando_connections ").await <= 1.0);
}

/// As over HTTP/1: a head has its time, however slowly it dribbles.
#[tokio::test(flavor = "multi_thread")]
async fn a_head_that_does_not_come_in_time_ends_the_connection() {
    let limits = Limits { header_read_timeout: Seconds(SOON), ..Limits::default() };
    let server = Server::start(&Fake::new(), limits).await;
    let mut client = Http2::connect(&server, 65_535);
    let started = Instant::now();
    // Without the flag that ends it.
    client.frame(HEADERS, 1, 1, &Http2::block("/health"));
    tokio::task::block_in_place(|| {
        client.0.set_read_timeout(Some(SOON / 10)).unwrap();
        // Empty continuations, until the server closes.
        while client.0.write_all(&[0, 0, 0, 9, 0, 0, 0, 0, 1]).is_ok() {
            assert!(started.elapsed() < LONG / 2);
            std::thread::sleep(SOON / 10);
        }
    });
    server.expect(get("/health"), 200).await;
}
