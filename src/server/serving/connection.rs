//! Connections: how many, how long the head of a request may take, how long a client may read
//! nothing.

use std::{future::Future, io, net::SocketAddr, pin::pin, sync::Arc, time::Duration};

use axum::{Router, body::Body};
use hyper::{Request, body::Incoming};
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::{conn::auto, graceful::GracefulShutdown},
    service::TowerToHyperService,
};
use tokio::{
    net::{TcpListener, TcpStream},
    time::sleep,
};
use tower::ServiceExt;

use super::idle_stream::IdleTimeoutStream;
use crate::server::{
    config::Limits,
    layers::client::Peer,
    metrics::SharedMetrics,
    resources::{Budget, Reservation},
};

/// Interval of the pings that find dead HTTP/2 connections, and the time for their answer.
const PING: Duration = Duration::from_secs(20);
/// Largest head of a request.
const LARGEST_HEAD: u32 = 64 * 1024;
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
    let most = limits.max_connections.get() as u64;
    let budget = Budget::new(most, metrics.connections.clone());
    let connections = GracefulShutdown::new();
    let builder = Arc::new(builder(limits));
    let mut idle = pin!(idle);
    loop {
        let accepted = tokio::select! {
            accepted = accept(&listener, &budget, disable_delay) => accepted,
            () = &mut idle => break,
        };
        let (stream, peer, reservation) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                if error.kind() != io::ErrorKind::ConnectionAborted {
                    tracing::warn!(%error, "a connection was not accepted");
                    sleep(BREATH).await;
                }
                continue;
            }
        };
        let io = TokioIo::new(IdleTimeoutStream::new(stream, limits));
        let router = router.clone();
        let service = tower::service_fn(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(Peer(peer));
            router.clone().oneshot(request.map(Body::new))
        });
        let connection =
            builder.serve_connection(io, TowerToHyperService::new(service)).into_owned();
        let connection = connections.watch(connection);
        tokio::spawn(async move {
            // Failures of a connection concern its client alone.
            if let Err(error) = connection.await {
                tracing::debug!(error = %error, "a connection ended early");
            }
            drop(reservation);
        });
    }
    connections.shutdown().await;
}

/// Accepts one connection. Connections above the budget wait for another to end.
async fn accept(
    listener: &TcpListener,
    budget: &Budget,
    tune: impl FnOnce(&TcpStream) -> io::Result<()>,
) -> io::Result<(TcpStream, SocketAddr, Reservation)> {
    let (stream, peer) = listener.accept().await?;
    let reservation = budget.reserve(1).await;
    // A connection that cannot be tuned is served all the same, or fails on its own.
    if let Err(error) = tune(&stream) {
        tracing::debug!(%error, "a connection was not tuned");
    }
    Ok((stream, peer, reservation))
}

/// Sends the events of a stream at once, small as they are.
fn disable_delay(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_connection_that_cannot_be_tuned_is_served_all_the_same() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let client = TcpStream::connect(address).await.unwrap();
        let refuse = |_: &TcpStream| Err(io::ErrorKind::InvalidInput.into());
        let accepted = accept(&listener, &Budget::unnamed(1), refuse).await;
        assert_eq!(accepted.unwrap().1, client.local_addr().unwrap());
    }
}
