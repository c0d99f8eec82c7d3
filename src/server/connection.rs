//! Connections: how many, how long a head may take, who takes nothing of an answer.

use std::{
    future::Future,
    io,
    net::SocketAddr,
    pin::{Pin, pin},
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use axum::{Router, body::Body};
use hyper::{Request, body::Incoming};
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::{conn::auto, graceful::GracefulShutdown},
    service::TowerToHyperService,
};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    sync::{OwnedSemaphorePermit, Semaphore},
    time::{Instant, Sleep, sleep, sleep_until},
};
use tower::ServiceExt;

use super::{
    access::Peer,
    config::Limits,
    metrics::{Counted, SharedMetrics},
};

/// Between two questions whether the other end of an HTTP/2 connection is still there, and for its answer.
const PING: Duration = Duration::from_secs(20);
/// Largest head of a request.
const LARGEST_HEAD: u32 = 64 * 1024;
/// Bytes from which a connection says whether it speaks HTTP/1 or 2: the preface of the latter.
const PREFACE: usize = 24;
/// Wait after a failed accept: the likely reason is that there are no file descriptors left.
const BREATH: Duration = Duration::from_millis(100);

/// Accepts connections and serves `router` on them until `idle`; then closes them, in good order.
pub(crate) async fn serve(
    listener: TcpListener,
    router: Router,
    limits: &Limits,
    metrics: SharedMetrics,
    idle: impl Future<Output = ()>,
) {
    let places = Arc::new(Semaphore::new(limits.max_connections.get()));
    let connections = GracefulShutdown::new();
    let builder = Arc::new(builder(limits));
    let mut idle = pin!(idle);
    loop {
        let accepted = tokio::select! {
            accepted = accept(&listener, &places) => accepted,
            () = &mut idle => break,
        };
        let (stream, peer, place) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                if error.kind() != io::ErrorKind::ConnectionAborted {
                    tracing::warn!(%error, "a connection was not accepted");
                    sleep(BREATH).await;
                }
                continue;
            }
        };
        let io = TokioIo::new(Patient::new(stream, limits));
        let router = router.clone();
        let service = tower::service_fn(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(Peer(peer));
            router.clone().oneshot(request.map(Body::new))
        });
        let connection = builder
            .serve_connection(io, TowerToHyperService::new(service))
            .into_owned();
        let connection = connections.watch(connection);
        let counted = Counted::new(&metrics.connections);
        tokio::spawn(async move {
            // What goes wrong on a connection is the other end's affair.
            if let Err(error) = connection.await {
                tracing::debug!(error = %error, "a connection ended early");
            }
            drop((place, counted));
        });
    }
    connections.shutdown().await;
}

async fn accept(
    listener: &TcpListener,
    places: &Arc<Semaphore>,
) -> io::Result<(TcpStream, SocketAddr, OwnedSemaphorePermit)> {
    let place = Arc::clone(places)
        .acquire_owned()
        .await
        .map_err(io::Error::other)?;
    let (stream, peer) = listener.accept().await?;
    // Events of a stream are small and wanted at once.
    stream.set_nodelay(true)?;
    Ok((stream, peer, place))
}

fn builder(limits: &Limits) -> auto::Builder<TokioExecutor> {
    let mut builder = auto::Builder::new(TokioExecutor::new());
    builder
        .http1()
        .timer(TokioTimer::new())
        .max_buf_size(LARGEST_HEAD as usize)
        .header_read_timeout(limits.header_read_timeout.0);
    builder
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(limits.max_http2_streams.get())
        .max_header_list_size(LARGEST_HEAD)
        .keep_alive_interval(PING)
        .keep_alive_timeout(PING);
    builder
}

/// A connection whose other end must say within a time what it speaks, and must go on taking what it is sent.
struct Patient {
    stream: TcpStream,
    /// Until so many bytes have come.
    unsaid: usize,
    say_until: Pin<Box<Sleep>>,
    take_within: Duration,
    stuck: Option<Pin<Box<Sleep>>>,
}

impl Patient {
    fn new(stream: TcpStream, limits: &Limits) -> Self {
        let until = Instant::now() + limits.header_read_timeout.0;
        Self {
            stream,
            unsaid: PREFACE,
            say_until: Box::pin(sleep_until(until)),
            take_within: limits.answer_idle_timeout.0,
            stuck: None,
        }
    }

    /// Whether a write that took nothing has waited for too long.
    fn waited<T>(
        &mut self,
        context: &mut Context<'_>,
        written: Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.stuck = None;
            return written;
        }
        let take_within = self.take_within;
        let stuck = self
            .stuck
            .get_or_insert_with(|| Box::pin(sleep(take_within)));
        match stuck.as_mut().poll(context) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl AsyncRead for Patient {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        let come = buffer.filled().len() - before;
        self.unsaid = self.unsaid.saturating_sub(come);
        if read.is_pending() && self.unsaid > 0 && self.say_until.as_mut().poll(context).is_ready()
        {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        read
    }
}

impl AsyncWrite for Patient {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.waited(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.waited(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
