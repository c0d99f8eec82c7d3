//! Start, service, drain and stop.

use std::{
    future::Future,
    io,
    net::{Ipv4Addr, SocketAddr},
    pin::pin,
    sync::Arc,
    time::Duration,
};

use futures_util::{Stream, StreamExt, stream};
use tokio::net::TcpListener;

use super::{connection, signals::Signals};
use crate::{
    engine::{Engine, EngineConfig, EngineError},
    server::{
        config::{
            Access, KeysError, Limits, LimitsError, Role, Seconds, ServerConfig, StorageError,
        },
        description::ModelDescription,
        metrics::{Metrics, SharedMetrics},
        router::router_with,
        state::{Generate, JobSettings, ServerState, SharedState},
        workers,
    },
};

/// Time for requests to answer once they were told to give up.
const LAST_WORDS: Duration = Duration::from_secs(1);
/// Time for connections to close once no request is in progress: a client that has sent half the
/// head of a request would otherwise hold the server for as long as it likes.
const CONNECTION_GRACE: Duration = Duration::from_secs(1);

/// Interval at which the model is checked.
const MODEL_CHECK: Duration = Duration::from_secs(1);

/// Why the server did not start, or did not stop cleanly.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// Two limits contradict each other.
    #[error(transparent)]
    Limits(#[from] LimitsError),
    /// Jobs cannot be kept as the settings say.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The API keys cannot be read, or there are none.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// The operating system gives no threads or no timers.
    #[error("the async runtime cannot be started")]
    Runtime(#[source] io::Error),
    /// The server could not be stopped cleanly.
    #[error("Ctrl-C and SIGTERM cannot be listened for")]
    Signals(#[source] io::Error),
    /// The address is taken, or not one of this machine.
    #[error("cannot listen on {address}")]
    Bind {
        /// Host and port.
        address: String,
        /// What the operating system says.
        source: io::Error,
    },
    /// The model directory or ONNX Runtime failed.
    #[error(transparent)]
    Model(#[from] EngineError),
    /// A defect of ours while the model was loaded.
    #[error("loading the model failed unexpectedly")]
    Load(#[source] tokio::task::JoinError),
    /// The listener has no address.
    #[error("listening failed")]
    Listen(#[source] io::Error),
    /// The model has stopped for good.
    #[error("the model has stopped")]
    ModelStopped,
    /// Requests were cut off at the end of the shutdown timeout.
    #[error(
        "{lost} requests were cut off: they had not ended {timeout} s after the server was told to \
         stop"
    )]
    DrainTimeout {
        /// Requests that were in progress.
        lost: usize,
        /// The time that they had.
        timeout: Seconds,
    },
    /// Requests were cut off because the server was told twice to stop.
    #[error("{lost} requests were cut off: the server was told twice to stop")]
    Hurried {
        /// Requests that were in progress.
        lost: usize,
    },
}

/// Settings of a server, apart from its model.
#[derive(Clone, Debug, Default)]
pub struct Service {
    /// Bounds of what callers may ask for.
    pub limits: Limits,
    /// API keys and allowed origins.
    pub access: Access,
    /// Counters and gauges.
    pub metrics: Arc<Metrics>,
    /// Where jobs are kept, and who works on them.
    pub jobs: JobSettings,
}

/// Serves on `listener` until `stop` gives an item and the requests in progress have ended.
///
/// Until `load` has completed, `/health` is answered 200, and `/ready`, `/info` and generations
/// 503. From the first item of `stop`, `/ready` and new generations are answered 503. The listener
/// stays open while requests are in progress, so that probes see that; then it closes. A second
/// item ends everything at once. The server also drains when the model stops for good.
///
/// # Errors
/// What `load` fails with; [`ServeError::ModelStopped`]; [`ServeError::DrainTimeout`] or
/// [`ServeError::Hurried`] when requests had to be cut off.
pub async fn run(
    service: Service,
    load: impl Future<Output = Result<Arc<dyn Generate>, ServeError>>,
    listener: TcpListener,
    stop: impl Stream<Item = ()>,
) -> Result<(), ServeError> {
    let address = listener.local_addr().map_err(ServeError::Listen)?;
    let Service { limits, access, metrics, jobs } = service;
    let state = ServerState::with_jobs(limits, metrics, jobs);
    // A stream that ends gives no more signals.
    let mut stop = pin!(stop.chain(stream::pending()));
    let idle = {
        let state = Arc::clone(&state);
        async move {
            state.lifecycle.draining().await;
            state.lifecycle.idle().await;
        }
    };
    let router = router_with(Arc::clone(&state), &access);
    let metrics = Arc::clone(&state.metrics);
    let server = connection::serve(listener, router, &state.limits, metrics, idle);
    let mut server = pin!(server);
    let ended = tokio::select! {
        () = &mut server => None,
        // Only a new process can start the model again.
        failed = load_and_watch(&state, load, address) => Some(Err(failed)),
        _ = stop.next() => {
            tracing::info!(in_progress = state.lifecycle.under_way(), "shutting down");
            Some(Ok(()))
        }
    };
    let ended = match ended {
        Some(ended) => ended.and(drain(&state, server, stop).await),
        None => {
            state.lifecycle.drain();
            Ok(())
        }
    };
    // They see that the server drains, and are in the middle of nothing that could be lost.
    let _ = tokio::time::timeout(LAST_WORDS, state.lifecycle.background.wait()).await;
    ended
}

/// Loads the model, and returns when that failed or the model has stopped.
async fn load_and_watch(
    state: &SharedState,
    load: impl Future<Output = Result<Arc<dyn Generate>, ServeError>>,
    address: SocketAddr,
) -> ServeError {
    let engine = match load.await {
        Ok(engine) => engine,
        Err(failed) => return failed,
    };
    tracing::info!(%address, model = engine.manifest().name, "listening");
    state.finish_loading(Arc::clone(&engine));
    workers::start(state);
    while engine.is_alive() {
        tokio::time::sleep(MODEL_CHECK).await;
    }
    tracing::error!("the model has stopped: no more requests are accepted");
    ServeError::ModelStopped
}

/// Accepts no more requests, and waits up to the shutdown timeout for those in progress.
async fn drain(
    state: &SharedState,
    mut server: impl Future<Output = ()> + Unpin,
    mut stop: impl Stream<Item = ()> + Unpin,
) -> Result<(), ServeError> {
    let lifecycle = &state.lifecycle;
    let timeout = state.limits.shutdown_timeout;
    lifecycle.drain();
    let closed = async {
        lifecycle.idle().await;
        tokio::time::sleep(CONNECTION_GRACE).await;
    };
    let why = tokio::select! {
        () = &mut server => return Ok(()),
        () = closed => return Ok(()),
        () = tokio::time::sleep(timeout.0) => Why::Timeout,
        _ = stop.next() => Why::Hurry,
    };
    let lost = lifecycle.under_way();
    lifecycle.abort();
    if lost == 0 {
        return Ok(());
    }
    // Elapsed or not, every request that could be answered has been.
    let _ = tokio::time::timeout(LAST_WORDS, server).await;
    Err(match why {
        Why::Timeout => ServeError::DrainTimeout { lost, timeout },
        Why::Hurry => ServeError::Hurried { lost },
    })
}

/// Why requests are cut off.
enum Why {
    Timeout,
    Hurry,
}

/// Listens, loads the model, and serves until the process is told to stop. Blocks.
///
/// # Errors
/// [`ServeError`] says what is wrong with the settings, the address or the model directory, and
/// whether requests were cut off in the end.
pub fn start(config: &ServerConfig) -> Result<(), ServeError> {
    config.limits.check()?;
    config.storage.check()?;
    let access = config.access()?;
    #[cfg(unix)]
    super::descriptors::raise(&config.limits);
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(ServeError::Runtime)?;
    let result = runtime.block_on(async {
        // First, so that a process that is told to stop while it starts also ends cleanly.
        let signals = Signals::install().map_err(ServeError::Signals)?;
        let listener = bind(&config.host, config.port).await?;
        let service = Service {
            limits: config.limits.clone(),
            access,
            metrics: SharedMetrics::default(),
            jobs: JobSettings {
                storage: config.storage.open().await?,
                role: config.storage.role,
                callbacks: config.storage.callbacks(),
            },
        };
        let load = open(config.engine(Arc::clone(&service.metrics) as _), config.storage.role);
        run(service, load, listener, signals.stream()).await
    });
    // Work that was cut off has been cancelled; it is not waited for.
    runtime.shutdown_timeout(LAST_WORDS);
    result
}

/// Listens on `host`, which may be in the brackets that a URL needs around an IPv6 address. `::`
/// takes IPv4 too; where the system has no IPv6, IPv4 alone.
async fn bind(host: &str, port: u16) -> Result<TcpListener, ServeError> {
    let name = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    let listener = match TcpListener::bind((name, port)).await {
        Err(error) if name == "::" && has_no_ipv6(&error) => {
            tracing::warn!("there is no IPv6 here: listening on 0.0.0.0 instead of ::");
            TcpListener::bind((Ipv4Addr::UNSPECIFIED, port)).await
        }
        bound => bound,
    };
    listener.map_err(|source| ServeError::Bind { address: format!("{host}:{port}"), source })
}

/// Whether a socket failed for want of IPv6: no such address family, or no such address.
fn has_no_ipv6(error: &io::Error) -> bool {
    const EAFNOSUPPORT: i32 = 97;
    error.raw_os_error() == Some(EAFNOSUPPORT) || error.kind() == io::ErrorKind::AddrNotAvailable
}

/// Opens the model on a blocking thread: reading and hashing it takes long.
async fn open(config: EngineConfig, role: Role) -> Result<Arc<dyn Generate>, ServeError> {
    let open = move || -> Result<Arc<dyn Generate>, ServeError> {
        let engine: Arc<dyn Generate> = match role {
            Role::Api => Arc::new(ModelDescription::open(&config)?),
            Role::All | Role::Worker => Arc::new(Engine::open(&config)?),
        };
        Ok(engine)
    };
    tokio::task::spawn_blocking(open).await.map_err(ServeError::Load)?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn hosts_are_listened_on_however_they_are_written() {
        for host in ["127.0.0.1", "localhost", "::"] {
            bind(host, 0).await.unwrap();
        }
        // Only where there is IPv6.
        if TcpListener::bind("[::1]:0").await.is_ok() {
            for host in ["::1", "[::1]"] {
                assert!(bind(host, 0).await.unwrap().local_addr().unwrap().is_ipv6());
            }
        }
        let nowhere = bind("[no such host]", 1).await.unwrap_err();
        assert!(nowhere.to_string().contains("[no such host]:1"), "{nowhere}");
    }
}
