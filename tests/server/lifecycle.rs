//! Through a socket: starting, draining, stopping, connections that break.

use std::{
    future::Future,
    io::{Read, Write},
    net::{Shutdown, SocketAddr, TcpStream},
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use bailando::engine::EngineError;
use bailando::server::{Generate, Limits, Seconds, ServeError, Service, run};
use futures_util::stream;
use tokio::{
    net::TcpListener,
    sync::{mpsc, oneshot},
    task::JoinHandle,
};

use crate::server::{
    client::{LONG, eventually, small_limits},
    fake::{BLOCK, Fake},
};

pub(crate) struct Server {
    pub(crate) address: SocketAddr,
    stop: mpsc::UnboundedSender<()>,
    pub(crate) task: JoinHandle<Result<(), ServeError>>,
}

impl Server {
    pub(crate) async fn start(fake: &Arc<Fake>, limits: Limits) -> Self {
        Self::start_with(fake, Service { limits, ..Service::default() }).await
    }

    pub(crate) async fn start_with(fake: &Arc<Fake>, service: Service) -> Self {
        let engine = Arc::clone(fake) as Arc<dyn Generate>;
        let server = Self::serve(async { Ok(engine) }, service).await;
        server.until_ready_says("HTTP/1.1 200").await;
        server
    }

    async fn loading(
        load: impl Future<Output = Result<Arc<dyn Generate>, ServeError>> + Send + 'static,
        limits: Limits,
    ) -> Self {
        Self::serve(load, Service { limits, ..Service::default() }).await
    }

    async fn serve(
        load: impl Future<Output = Result<Arc<dyn Generate>, ServeError>> + Send + 'static,
        service: Service,
    ) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, told) = mpsc::unbounded_channel();
        let task = tokio::spawn(async move {
            let told =
                stream::unfold(told, |mut told| async { told.recv().await.map(|()| ((), told)) });
            run(service, load, listener, told).await
        });
        Self { address, stop, task }
    }

    pub(crate) fn stop(&self) {
        self.stop.send(()).unwrap();
    }

    /// Waits until `/ready` is answered with something that holds `text`, and gives the answer.
    pub(crate) async fn until_ready_says(&self, text: &str) -> String {
        let what = format!("/ready says {text:?}");
        eventually(&what, async || {
            let answer = self.exchange(get("/ready")).await.unwrap();
            answer.contains(text).then_some(answer)
        })
        .await
    }

    pub(crate) async fn expect(&self, request: Vec<u8>, status: u16) -> String {
        let answer = self.exchange(request).await.unwrap();
        let wanted = format!("HTTP/1.1 {status}");
        assert!(answer.starts_with(&wanted), "wanted {wanted}: {answer:?}");
        answer
    }

    /// Sends bytes as they are, and reads until the server closes.
    pub(crate) fn exchange(&self, request: Vec<u8>) -> JoinHandle<String> {
        let address = self.address;
        tokio::task::spawn_blocking(move || {
            let mut stream = TcpStream::connect(address).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            // The server may answer and close before it has read everything.
            let _ = stream.write_all(&request);
            let mut answer = Vec::new();
            let _ = stream.read_to_end(&mut answer);
            String::from_utf8_lossy(&answer).into_owned()
        })
    }
}

pub(crate) fn get(path: &str) -> Vec<u8> {
    format!("GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n").into_bytes()
}

pub(crate) fn post(audio: &[u8]) -> Vec<u8> {
    post_to("/generate", audio)
}

pub(crate) fn post_to(path: &str, audio: &[u8]) -> Vec<u8> {
    let mut request = format!(
        "POST {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: {}\r\n\r\n",
        audio.len()
    )
    .into_bytes();
    request.extend(audio);
    request
}

#[tokio::test(flavor = "multi_thread")]
async fn draining_ends_what_was_accepted_and_refuses_the_rest() {
    let fake = Fake::new();
    let server = Server::start(&fake, small_limits()).await;
    assert!(server.exchange(get("/ready")).await.unwrap().starts_with("HTTP/1.1 200"));
    let running = server.exchange(post(BLOCK));
    fake.wait_started(1).await;
    server.stop();
    let not_ready = server.until_ready_says("HTTP/1.1 503").await;
    assert!(not_ready.contains("\"draining\""), "{not_ready}");
    let refused = server.exchange(post(b"song")).await.unwrap();
    assert!(refused.starts_with("HTTP/1.1 503"), "{refused}");
    assert!(refused.contains("retry-after: "), "{refused}");
    fake.release();
    assert!(running.await.unwrap().starts_with("HTTP/1.1 200"));
    server.task.await.unwrap().unwrap();
    assert!(TcpStream::connect(server.address).is_err());
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idle_server_stops_at_once() {
    let fake = Fake::new();
    let server = Server::start(&fake, Limits::default()).await;
    assert!(server.exchange(post(b"song")).await.unwrap().starts_with("HTTP/1.1 200"));
    let idle = TcpStream::connect(server.address).unwrap();
    let started = Instant::now();
    server.stop();
    server.task.await.unwrap().unwrap();
    assert!(started.elapsed() < LONG);
    drop(idle);
}

/// Half a request's head is no request: it is neither waited for nor called lost.
#[tokio::test(flavor = "multi_thread")]
async fn half_a_head_does_not_hold_the_server() {
    let server = Server::start(&Fake::new(), Limits::default()).await;
    let mut half = TcpStream::connect(server.address).unwrap();
    half.write_all(b"GET /health HTTP/1.1\r\nHost: x\r\n").unwrap();
    server.expect(get("/health"), 200).await;
    let started = Instant::now();
    server.stop();
    server.task.await.unwrap().unwrap();
    assert!(started.elapsed() < LONG);
    drop(half);
}

#[tokio::test(flavor = "multi_thread")]
async fn told_twice_the_server_does_not_wait() {
    let fake = Fake::new();
    let server = Server::start(&fake, small_limits()).await;
    let running = server.exchange(post(BLOCK));
    fake.wait_started(1).await;
    let started = Instant::now();
    server.stop();
    server.stop();
    let answer = running.await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 503"), "{answer}");
    let ended = server.task.await.unwrap();
    assert!(matches!(ended, Err(ServeError::Hurried { lost: 1 })));
    assert!(started.elapsed() < LONG);
    fake.wait_ended(1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn while_the_model_is_loaded_the_server_lives_and_is_not_ready() {
    let (done, loaded) = oneshot::channel();
    let load = async { Ok(loaded.await.unwrap()) };
    let server = Server::loading(load, Limits::default()).await;
    server.expect(get("/health"), 200).await;
    for request in [get("/ready"), get("/info"), post(b"song")] {
        let answer = server.expect(request, 503).await;
        assert!(answer.contains("\"loading\""), "{answer}");
        assert!(answer.contains("retry-after: "), "{answer}");
    }
    assert!(done.send(Fake::new() as Arc<dyn Generate>).is_ok());
    server.until_ready_says("HTTP/1.1 200").await;
    server.expect(post(b"song"), 200).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_that_cannot_be_loaded_ends_the_server() {
    let load = async { Err(ServeError::from(EngineError::Stopped)) };
    let server = Server::loading(load, Limits::default()).await;
    let ended = server.task.await.unwrap();
    assert!(matches!(ended, Err(ServeError::Model(_))));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_that_stops_for_good_ends_the_server() {
    let fake = Fake::new();
    let server = Server::start(&fake, small_limits()).await;
    server.expect(get("/ready"), 200).await;
    let running = server.exchange(post(BLOCK));
    fake.wait_started(1).await;
    fake.stopped.store(true, Ordering::SeqCst);
    let refused = server.expect(post(b"song"), 503).await;
    assert!(refused.contains("retry-after: "), "{refused}");
    // What still has an answer gets it.
    server.until_ready_says("\"draining\"").await;
    fake.release();
    assert!(running.await.unwrap().starts_with("HTTP/1.1 200"));
    let ended = server.task.await.unwrap();
    assert!(matches!(ended, Err(ServeError::ModelStopped)));
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_that_outlive_the_drain_are_told_so() {
    let fake = Fake::new();
    let limits = Limits { shutdown_timeout: Seconds(Duration::from_millis(200)), ..small_limits() };
    let server = Server::start(&fake, limits).await;
    let running = server.exchange(post(BLOCK));
    fake.wait_started(1).await;
    server.stop();
    let answer = running.await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 503"), "{answer}");
    assert!(answer.contains("\"draining\""), "{answer}");
    let ended = server.task.await.unwrap();
    assert!(matches!(ended, Err(ServeError::DrainTimeout { lost: 1, .. })));
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_closed_connection_stops_its_work() {
    let fake = Fake::new();
    let server = Server::start(&fake, small_limits()).await;
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream.write_all(&post(BLOCK)).unwrap();
    fake.wait_started(1).await;
    stream.shutdown(Shutdown::Both).unwrap();
    drop(stream);
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    assert!(server.exchange(post(b"song")).await.unwrap().starts_with("HTTP/1.1 200"));
}

/// An upload that breaks off, and one that is refused while it is still being sent.
#[tokio::test(flavor = "multi_thread")]
async fn answers_reach_clients_that_are_still_sending() {
    let fake = Fake::new();
    let server = Server::start(&fake, Limits::default()).await;
    // Refused at its head, at its first chunk, and somewhere in the middle.
    let large = vec![b'x'; 30_000_000];
    let mut wrong_option = post(&large);
    wrong_option.splice(5..14, *b"/generate?fps=1");
    for (request, status) in [(wrong_option, "400"), (post(&large), "413")] {
        let answer = server.exchange(request).await.unwrap();
        let wanted = format!("HTTP/1.1 {status}");
        assert!(answer.starts_with(&wanted), "wanted {wanted}: {answer:?}");
    }
    let mut declared = get("/generate");
    declared.splice(0..3, *b"POST");
    let end = declared.len() - 2;
    declared.splice(end..end, *b"Content-Length: 100000001\r\n");
    let started = Instant::now();
    let address = server.address;
    let answer = tokio::task::spawn_blocking(move || {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(&declared).unwrap();
        let mut start = [0; 12];
        stream.read_exact(&mut start).unwrap();
        start
    })
    .await
    .unwrap();
    assert_eq!(&answer, b"HTTP/1.1 413");
    assert!(started.elapsed() < Duration::from_secs(1));
    let mut half = TcpStream::connect(server.address).unwrap();
    half.write_all(&post(b"0123456789")[..80]).unwrap();
    drop(half);
    assert!(server.exchange(post(b"song")).await.unwrap().starts_with("HTTP/1.1 200"));
}
