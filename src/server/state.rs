//! What all handlers share.

use std::{
    future::Future,
    sync::{Arc, OnceLock, atomic::AtomicBool},
};

use super::{
    callbacks::CallbackPolicy,
    config::{Limits, Role, Seconds},
    error::ServerError,
    info::Info,
    jobs::{service::Jobs, storage::JobStorage},
    metrics::SharedMetrics,
    resources::Resources,
    response::paced::Pace,
    serving::lifecycle::Lifecycle,
};
use crate::{
    codebook::Memory,
    engine::{Engine, EngineError, Generation, GenerationOptions, GenerationRequest, Pending},
    model::Manifest,
    motion::Positions,
};

/// What the server needs of the engine: a seam, so that limits and faults can be tested without a
/// model.
pub trait Generate: Send + Sync + 'static {
    /// The loaded model's manifest.
    fn manifest(&self) -> &Manifest;

    /// SHA-256 of the loaded manifest, which identifies the whole model.
    fn model_sha256(&self) -> &str;

    /// How often the model's training used each code; none where the model does not say.
    fn memory(&self) -> Option<&Memory> {
        None
    }

    /// Whether generations can still succeed: false once the model has stopped for good.
    fn is_alive(&self) -> bool {
        true
    }

    /// Checks `options` against the model without any work.
    ///
    /// # Errors
    /// [`EngineError::Option`] names the first option that does not fit.
    fn check(&self, options: &GenerationOptions) -> Result<(), EngineError>;

    /// Submits a generation. Dropping the returned future cancels it.
    fn submit(&self, request: GenerationRequest) -> Generation;

    /// Shows what a pair of pose codes looks like, `[frames, joints, 3]` in metres. The result is
    /// [`EngineError::Option`] for a code that is not in the vocabulary.
    fn pose(&self, codes: [u32; 2]) -> Pending<Positions>;
}

impl Generate for Engine {
    fn manifest(&self) -> &Manifest {
        self.manifest()
    }

    fn model_sha256(&self) -> &str {
        self.model_sha256()
    }

    fn memory(&self) -> Option<&Memory> {
        self.memory()
    }

    fn is_alive(&self) -> bool {
        self.is_alive()
    }

    fn check(&self, options: &GenerationOptions) -> Result<(), EngineError> {
        self.check(options)
    }

    fn submit(&self, request: GenerationRequest) -> Generation {
        self.submit(request)
    }

    fn pose(&self, codes: [u32; 2]) -> Pending<Positions> {
        self.pose(codes)
    }
}

/// When to ask again while the model is loaded: it takes a few seconds.
const LOADING_RETRY: Seconds = Seconds::new(2);

/// Handle to what all handlers share.
pub(crate) type SharedState = Arc<ServerState>;

/// What all handlers share.
pub(crate) struct ServerState {
    loaded: OnceLock<Loaded>,
    pub(crate) limits: Limits,
    pub(crate) metrics: SharedMetrics,
    pub(crate) resources: Arc<Resources>,
    pub(crate) jobs: Arc<Jobs>,
    pub(crate) callbacks: CallbackPolicy,
    pub(crate) role: Role,
    /// Whether the tasks that work on jobs have been started.
    pub(crate) working: AtomicBool,
    pub(crate) lifecycle: Lifecycle,
}

/// Where jobs are kept, who works on them, and who is told.
#[derive(Clone, Debug, Default)]
pub struct JobSettings {
    /// Where they are kept.
    pub storage: JobStorage,
    /// What this process does for them.
    pub role: Role,
    /// Who may be told of their end.
    pub callbacks: CallbackPolicy,
}

/// What there is once the model has been loaded.
pub(crate) struct Loaded {
    pub(crate) engine: Arc<dyn Generate>,
    pub(crate) info: Info,
}

impl ServerState {
    /// Without a model yet; jobs are kept in memory.
    pub(crate) fn loading(limits: Limits, metrics: SharedMetrics) -> SharedState {
        Self::with_jobs(limits, metrics, JobSettings::default())
    }

    /// Without a model yet.
    pub(crate) fn with_jobs(
        limits: Limits,
        metrics: SharedMetrics,
        jobs: JobSettings,
    ) -> SharedState {
        Arc::new(Self {
            loaded: OnceLock::new(),
            resources: Arc::new(Resources::new(&limits, jobs.role, &metrics)),
            jobs: Arc::new(Jobs::new(jobs.storage, &limits)),
            callbacks: jobs.callbacks,
            role: jobs.role,
            working: AtomicBool::new(false),
            lifecycle: Lifecycle::default(),
            metrics,
            limits,
        })
    }

    /// Takes the model; a second one changes nothing.
    pub(crate) fn finish_loading(&self, engine: Arc<dyn Generate>) {
        self.metrics.loaded(&engine.manifest().name);
        self.loaded.get_or_init(|| Loaded {
            info: Info::new(engine.manifest(), engine.model_sha256(), &self.limits),
            engine,
        });
    }

    /// # Errors
    /// [`ServerError::Loading`] as long as there is no model.
    pub(crate) fn loaded(&self) -> Result<&Loaded, ServerError> {
        self.loaded.get().ok_or(ServerError::Loading { retry_after: LOADING_RETRY })
    }

    /// # Errors
    pub(crate) fn engine(&self) -> Result<&Arc<dyn Generate>, ServerError> {
        let engine = &self.loaded()?.engine;
        match engine.is_alive() {
            true => Ok(engine),
            false => Err(ServerError::ModelStopped),
        }
    }

    /// What `work` comes to, unless the time for it is over or the server gives up first.
    pub(crate) async fn in_time<T>(
        &self,
        work: impl Future<Output = Result<T, ServerError>>,
    ) -> Result<T, ServerError> {
        tokio::select! {
            done = tokio::time::timeout(self.limits.request_timeout.0, work) => {
                done.unwrap_or_else(|_| Err(self.timeout()))
            }
            () = self.lifecycle.aborted() => Err(self.draining()),
        }
    }

    /// How fast a response must be taken.
    pub(crate) fn pace(&self) -> Pace {
        Pace::new(&self.limits, self.lifecycle.stopping())
    }

    /// The answer to a request whose time is over.
    pub(crate) fn timeout(&self) -> ServerError {
        ServerError::Timeout {
            limit: self.limits.request_timeout,
            retry_after: self.resources.retry_after(),
        }
    }

    /// The answer to new requests once the server was told to stop.
    pub(crate) fn draining(&self) -> ServerError {
        ServerError::Draining { retry_after: self.limits.shutdown_timeout }
    }
}
