//! Connections: slow ones, silent ones, too many, and HTTP/2.

use std::{
    io::{ErrorKind, Read, Write},
    net::TcpStream,
    num::{NonZeroU32, NonZeroUsize},
    time::{Duration, Instant},
};

use bailando::server::{Limits, Seconds};

use crate::server::{
    client::LONG,
    fake::Fake,
    lifecycle::{Server, post},
};

const SOON: Duration = Duration::from_millis(300);

fn impatient() -> Limits {
    Limits { header_read_timeout: Seconds(SOON), ..Limits::default() }
}

/// Sends `pieces` one by one; how long it took until the server closed.
fn dropped_after(server: &Server, pieces: Vec<&'static [u8]>) -> Duration {
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    let started = Instant::now();
    for piece in pieces {
        // The server may have closed already.
        let _ = stream.write_all(piece);
        std::thread::sleep(Duration::from_millis(50));
    }
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    started.elapsed()
}

#[tokio::test(flavor = "multi_thread")]
async fn heads_that_do_not_come_in_time_are_dropped() {
    let server = Server::start(&Fake::new(), impatient()).await;
    tokio::task::block_in_place(|| {
        let dribble: Vec<&[u8]> = vec![b"GET /health HTTP/1.1\r\n", b"Host: x\r\n", b"X-A: b\r\n"];
        let http2: Vec<&[u8]> = vec![b"PRI * HTTP/2.0\r\n"];
        for pieces in [Vec::new(), vec![&b"G"[..]], dribble, http2] {
            let time = dropped_after(&server, pieces.clone());
            assert!(time >= SOON / 2 && time < LONG / 2, "{pieces:?}: {time:?}");
        }
    });
    server.expect(post(b"song"), 200).await;
}

/// A connection between two requests waits longer than a head that has begun.
#[tokio::test(flavor = "multi_thread")]
async fn an_idle_connection_is_kept_alive_and_a_slow_head_is_not() {
    let server = Server::start(&Fake::new(), impatient()).await;
    tokio::task::block_in_place(|| {
        let mut stream = TcpStream::connect(server.address).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        let mut ask = || {
            stream.write_all(b"GET /health HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
            let mut answer = [0; 12];
            stream.read_exact(&mut answer).unwrap();
            assert_eq!(&answer, b"HTTP/1.1 200");
            while !answer.ends_with(b"}") {
                let mut byte = [0];
                stream.read_exact(&mut byte).unwrap();
                answer.rotate_left(1);
                answer[11] = byte[0];
            }
        };
        ask();
        std::thread::sleep(SOON * 4);
        ask();
        stream.write_all(b"GET /health HTTP/1.1\r\nHo").unwrap();
        let started = Instant::now();
        let _ = stream.read_to_end(&mut Vec::new());
        assert!(started.elapsed() >= SOON / 2 && started.elapsed() < LONG / 2);
    });
    let closing = Limits { connection_idle_timeout: Seconds(SOON), ..Limits::default() };
    let server = Server::start(&Fake::new(), closing).await;
    tokio::task::block_in_place(|| {
        let time = dropped_after(&server, vec![b"GET /health HTTP/1.1\r\nHost: x\r\n\r\n"]);
        assert!(time >= SOON && time < LONG / 2, "{time:?}");
    });
}

/// The preface of HTTP/2 with prior knowledge is answered with settings, which say how much is
/// taken at once.
#[tokio::test(flavor = "multi_thread")]
async fn http2_is_spoken_without_tls() {
    const SETTINGS: [u8; 9] = [0, 0, 0, 4, 0, 0, 0, 0, 0];
    let limits = Limits { max_http2_streams: NonZeroU32::new(7).unwrap(), ..Limits::default() };
    let server = Server::start(&Fake::new(), limits).await;
    let settings = tokio::task::block_in_place(|| {
        let mut stream = TcpStream::connect(server.address).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        stream.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n").unwrap();
        stream.write_all(&SETTINGS).unwrap();
        let mut head = [0; 9];
        stream.read_exact(&mut head).unwrap();
        assert_eq!(head[3], 4, "{head:?}");
        let length = u32::from_be_bytes([0, head[0], head[1], head[2]]);
        let mut settings = vec![0; length as usize];
        stream.read_exact(&mut settings).unwrap();
        settings
    });
    // SETTINGS_MAX_CONCURRENT_STREAMS (RFC 9113, section 6.5.2).
    let streams = settings.chunks(6).find(|setting| setting[..2] == [0, 3]);
    assert_eq!(streams.unwrap()[2..], 7_u32.to_be_bytes());
}

#[tokio::test(flavor = "multi_thread")]
async fn who_takes_nothing_of_its_answer_is_dropped() {
    let fake = Fake::new();
    let limits = Limits {
        answer_idle_timeout: Seconds(SOON),
        max_concurrent_requests: NonZeroUsize::MIN,
        ..Limits::default()
    };
    let server = Server::start(&fake, limits).await;
    // So many answers, of which nothing is read, that no buffer holds them all.
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream.set_write_timeout(Some(LONG)).unwrap();
    let request = b"GET /api-doc/openapi.json HTTP/1.1\r\nHost: x\r\n\r\n";
    let started = Instant::now();
    let dropped = tokio::task::block_in_place(|| {
        loop {
            if let Err(error) = stream.write_all(request) {
                return error.kind();
            }
        }
    });
    // Closed by the server, and not a write that waited for ever.
    let closed = [ErrorKind::ConnectionReset, ErrorKind::BrokenPipe];
    assert!(closed.contains(&dropped), "{dropped:?}");
    assert!(started.elapsed() < LONG / 2);
    server.expect(post(b"song"), 200).await;
}

/// RELIABILITY: a refusal reaches who is still sending.
#[tokio::test(flavor = "multi_thread")]
async fn a_refusal_reaches_a_client_that_is_still_sending() {
    let limits =
        Limits { rate_limit: NonZeroU32::new(1), rate_burst: NonZeroU32::MIN, ..Limits::default() };
    let server = Server::start(&Fake::new(), limits).await;
    server.expect(post(b"song"), 200).await;
    let refused = server.expect(post(&vec![b'x'; 20_000_000]), 429).await;
    assert!(refused.contains("rate_limited"), "{refused}");
}
