//! Connections: how many, how long the head of a request may take, how long they may be idle.

use std::{
    future::Future,
    io,
    net::SocketAddr,
    pin::{Pin, pin},
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use axum::{
    Router,
    body::{Body, HttpBody},
};
use bytes::Bytes;
use http_body::{Frame, SizeHint};
use hyper::{Request, body::Incoming};
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    server::conn::auto,
    service::TowerToHyperService,
};
use tokio::{
    net::{TcpListener, TcpStream},
    time::sleep,
};
use tokio_util::{sync::CancellationToken, task::TaskTracker};
use tower::ServiceExt;

use super::{
    cut::{StreamExecutor, until_cut},
    idle_stream::IdleTimeoutStream,
    places::{InProgress, Place, Places},
};
use crate::server::{
    config::Limits,
    layers::client::{Peer, Spare},
    metrics::SharedMetrics,
};

/// Interval of the pings that find dead HTTP/2 connections, and the time for their answer.
const PING: Duration = Duration::from_secs(20);
/// Largest head of a request.
const LARGEST_HEAD: u32 = 64 * 1024;
/// Wait after a failed accept: the likely reason is that there are no file descriptors left.
const BREATH: Duration = Duration::from_millis(100);
/// Time for an idle connection to close in good order.
const FAREWELL: Duration = Duration::from_secs(2);

/// Accepts connections and serves `router` on them until `idle`; then closes them, in good order.
pub(crate) async fn serve(
    listener: TcpListener,
    router: Router,
    limits: &Limits,
    metrics: SharedMetrics,
    idle: impl Future<Output = ()>,
) {
    let places = Places::new(limits, metrics.connections.clone());
    let (connections, closing) = (TaskTracker::new(), CancellationToken::new());
    let builder = Arc::new(builder(limits));
    let mut idle = pin!(idle);
    loop {
        let accepted = tokio::select! {
            accepted = accept(&listener, disable_delay) => accepted,
            () = &mut idle => break,
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                if error.kind() != io::ErrorKind::ConnectionAborted {
                    tracing::warn!(%error, "a connection was not accepted");
                    sleep(BREATH).await;
                }
                continue;
            }
        };
        let peer = Peer(peer);
        let place = places.enter(peer.client());
        let connection = Connection {
            stream: IdleTimeoutStream::new(stream, Arc::clone(&place), limits),
            peer,
            place,
            router: router.clone(),
            builder: Arc::clone(&builder),
            idle_timeout: limits.connection_idle_timeout.0,
            closing: closing.clone(),
        };
        connections.spawn(until_cut(connection.serve()));
    }
    closing.cancel();
    connections.close();
    connections.wait().await;
}

/// An accepted connection.
struct Connection {
    stream: IdleTimeoutStream,
    peer: Peer,
    place: Arc<Place>,
    router: Router,
    builder: Arc<auto::Builder<StreamExecutor>>,
    idle_timeout: Duration,
    closing: CancellationToken,
}

impl Connection {
    /// Serves it to its end, or until it must give way or has been idle for too long.
    async fn serve(self) {
        let Self { stream, peer, place, router, builder, idle_timeout, closing } = self;
        let requested = Arc::clone(&place);
        let service = tower::service_fn(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(peer);
            if requested.spare {
                request.extensions_mut().insert(Spare);
            }
            let in_progress = requested.request();
            let answer = router.clone().oneshot(request.map(Body::new));
            async move {
                let answer = answer.await?;
                Ok::<_, std::convert::Infallible>(
                    answer.map(|body| Answering { body, _in_progress: in_progress }),
                )
            }
        });
        let service = TowerToHyperService::new(service);
        let mut served = pin!(builder.serve_connection(TokioIo::new(stream), service));
        tokio::select! {
            ended = served.as_mut() => return told(ended),
            () = place.displaced() => return,
            () = closing.cancelled() => served.as_mut().graceful_shutdown(),
            () = place.idle_for(idle_timeout) => {
                served.as_mut().graceful_shutdown();
                // No error that is worth telling.
                let _ = tokio::time::timeout(FAREWELL, served).await;
                return;
            }
        }
        told(served.await);
    }
}

/// Failures of a connection concern its client alone.
fn told(ended: Result<(), Box<dyn std::error::Error + Send + Sync>>) {
    if let Err(error) = ended {
        tracing::debug!(error = %error, "a connection ended early");
    }
}

/// A body while it is sent: its connection is not idle.
struct Answering {
    body: Body,
    _in_progress: InProgress,
}

impl HttpBody for Answering {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// Accepts one connection.
async fn accept(
    listener: &TcpListener,
    tune: impl FnOnce(&TcpStream) -> io::Result<()>,
) -> io::Result<(TcpStream, SocketAddr)> {
    let (stream, peer) = listener.accept().await?;
    // A connection that cannot be tuned is served all the same, or fails on its own.
    if let Err(error) = tune(&stream) {
        tracing::debug!(%error, "a connection was not tuned");
    }
    Ok((stream, peer))
}

/// Sends the events of a stream at once, small as they are.
fn disable_delay(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)
}

fn builder(limits: &Limits) -> auto::Builder<StreamExecutor> {
    let mut builder = auto::Builder::new(StreamExecutor);
    builder
        .http1()
        .timer(TokioTimer::new())
        .max_buf_size(LARGEST_HEAD as usize)
        // Also runs while a connection is idle. The stream ends heads that take too long.
        .header_read_timeout(limits.connection_idle_timeout.0 + limits.header_read_timeout.0);
    builder
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(limits.max_http2_streams.get())
        .max_header_list_size(LARGEST_HEAD)
        .keep_alive_interval(PING)
        .keep_alive_timeout(PING);
    builder
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_connection_that_cannot_be_tuned_is_served_all_the_same() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let client = TcpStream::connect(address).await.unwrap();
        let refuse = |_: &TcpStream| Err(io::ErrorKind::InvalidInput.into());
        let accepted = accept(&listener, refuse).await;
        assert_eq!(accepted.unwrap().1, client.local_addr().unwrap());
    }
}
