//! Listening, and stopping in good order.

use std::{future::Future, sync::Arc, time::Duration};

use anyhow::Context;
use tokio::net::TcpListener;

use super::{
    config::{Seconds, ServerConfig},
    router::router_with,
    state::{Generate, ServerState},
};
use crate::engine::Choreographer;

/// How long requests have to answer once they were told to give up.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Why serving ended other than in good order.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The listener failed.
    #[error("listening failed: {0}")]
    Listen(#[from] std::io::Error),
    /// Requests were cut off.
    #[error(
        "{lost} requests were cut off: they had not ended {timeout} s after the server was told to stop"
    )]
    DrainTimeout {
        /// Requests that were under way.
        lost: usize,
        /// The time they had.
        timeout: Seconds,
    },
}

/// Serves on `listener` until `shutdown` completes and the requests under way have ended.
///
/// From `shutdown` on, `/ready` and new generations are answered 503. The listener stays open while
/// requests are under way, so that probes see that; then it closes.
///
/// # Errors
/// [`ServeError::DrainTimeout`] when requests had to be cut off.
pub async fn run(
    config: &ServerConfig,
    engine: Arc<dyn Generate>,
    listener: TcpListener,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let timeout = config.limits.shutdown_timeout;
    let state = ServerState::new(engine, config.limits.clone());
    let stop = {
        let state = Arc::clone(&state);
        async move {
            shutdown.await;
            tracing::info!(under_way = state.lifecycle.under_way(), "shutting down");
            state.lifecycle.drain();
            state.lifecycle.idle().await;
        }
    };
    let server = axum::serve(listener, router_with(Arc::clone(&state)))
        .with_graceful_shutdown(stop)
        .into_future();
    let deadline = async {
        state.lifecycle.draining().await;
        tokio::time::sleep(timeout.0).await;
    };
    tokio::pin!(server);
    tokio::select! {
        ended = &mut server => return Ok(ended?),
        () = deadline => {}
    }
    let lost = state.lifecycle.under_way();
    state.lifecycle.abort();
    // Elapsed or not, what could be answered has been.
    let _ = tokio::time::timeout(LAST_WORDS, server).await;
    Err(ServeError::DrainTimeout { lost, timeout })
}

/// Loads the model, listens, and serves until the process is told to stop. Blocks.
///
/// # Errors
/// One line saying what is wrong with the address or the model directory; [`ServeError`] later.
pub fn start(config: &ServerConfig) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("the async runtime cannot be started")?;
    let result = runtime.block_on(async {
        let address = format!("{}:{}", config.host, config.port);
        let listener = TcpListener::bind((config.host.as_str(), config.port))
            .await
            .with_context(|| format!("cannot listen on {address}"))?;
        let engine = Choreographer::open(&config.engine())?;
        tracing::info!(
            address = %listener.local_addr()?,
            model = engine.manifest().name,
            "listening"
        );
        run(config, Arc::new(engine), listener, told_to_stop()).await?;
        anyhow::Ok(())
    });
    // Work that was cut off has been cancelled; it is not waited for.
    runtime.shutdown_timeout(LAST_WORDS);
    result
}

/// Completes on Ctrl-C or SIGTERM.
async fn told_to_stop() {
    let interrupt = async {
        if let Err(error) = tokio::signal::ctrl_c().await {
            tracing::error!(%error, "Ctrl-C cannot be listened for");
            std::future::pending::<()>().await;
        }
    };
    #[cfg(unix)]
    let terminate = async {
        use tokio::signal::unix::{SignalKind, signal};
        match signal(SignalKind::terminate()) {
            Ok(mut terminate) => {
                terminate.recv().await;
            }
            Err(error) => {
                tracing::error!(%error, "SIGTERM cannot be listened for");
                std::future::pending::<()>().await;
            }
        }
    };
    #[cfg(not(unix))]
    let terminate = std::future::pending::<()>();
    tokio::select! {
        () = interrupt => {}
        () = terminate => {}
    }
}
