//! What all handlers share.

use std::{
    future::Future,
    sync::{Arc, OnceLock},
    time::Duration,
};

use tokio::sync::Semaphore;

use super::{
    access::{Access, Rates},
    admission::Admission,
    config::{Limits, Seconds},
    error::ServerError,
    info::Info,
    jobs::{JobStore, MemoryStore},
    lifecycle::Lifecycle,
    metrics::SharedMetrics,
    room::{Room, Share},
    uploads::Uploads,
};
use crate::{
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

/// How long an answer waits for others to be taken, where there is time for twice that.
const WAIT_FOR_ROOM: Duration = Duration::from_secs(10);

/// When to ask again while the model is loaded: it takes a few seconds.
const LOADING_RETRY: Seconds = Seconds::new(2);

/// Handle to what all handlers share.
pub(crate) type SharedState = Arc<ServerState>;

/// What all handlers share.
pub(crate) struct ServerState {
    loaded: OnceLock<Loaded>,
    pub(crate) limits: Limits,
    pub(crate) access: Access,
    pub(crate) rates: Option<Rates>,
    pub(crate) metrics: SharedMetrics,
    pub(crate) uploads: Uploads,
    pub(crate) admission: Arc<Admission>,
    /// Seconds of audio that may be worked on.
    pub(crate) audio: Room,
    /// Bytes of answers that may wait for their readers.
    pub(crate) answers: Room,
    pub(crate) jobs: Box<dyn JobStore>,
    /// Places to work in that jobs may take: half of all, at least one.
    pub(crate) job_slots: Semaphore,
    /// Results of jobs that may be written at the same time.
    pub(crate) writers: Semaphore,
    pub(crate) lifecycle: Lifecycle,
}

/// What there is once the model has been loaded.
pub(crate) struct Loaded {
    pub(crate) engine: Arc<dyn Generate>,
    pub(crate) info: Info,
}

impl ServerState {
    /// Without a model yet.
    pub(crate) fn loading(limits: Limits, access: Access, metrics: SharedMetrics) -> SharedState {
        let audio_gauge = metrics.audio_in_flight.clone();
        Arc::new(Self {
            loaded: OnceLock::new(),
            rates: Rates::new(&limits),
            uploads: Uploads::new(&limits, Arc::clone(&metrics)),
            admission: Admission::new(&limits, Arc::clone(&metrics)),
            audio: Room::new(limits.audio_seconds_in_flight as u64, Some(audio_gauge)),
            answers: Room::new(limits.answer_memory.0, None),
            jobs: Box::new(MemoryStore::new(limits.max_jobs.get(), limits.job_ttl)),
            job_slots: Semaphore::new((limits.max_concurrent_requests.get() / 2).max(1)),
            writers: Semaphore::new(limits.max_concurrent_requests.get()),
            lifecycle: Lifecycle::default(),
            access,
            metrics,
            limits,
        })
    }

    /// Takes the model; a second one changes nothing.
    pub(crate) fn finish_loading(&self, engine: Arc<dyn Generate>) {
        self.metrics.loaded(&engine.manifest().name);
        self.loaded.get_or_init(|| Loaded {
            info: Info::new(engine.as_ref(), &self.limits),
            engine,
        });
    }

    /// # Errors
    /// [`ServerError::Loading`] as long as there is no model.
    pub(crate) fn loaded(&self) -> Result<&Loaded, ServerError> {
        self.loaded.get().ok_or(ServerError::Loading {
            retry_after: LOADING_RETRY,
        })
    }

    /// # Errors
    /// [`ServerError::Loading`], and [`ServerError::ModelStopped`] once the model has stopped.
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

    /// Reserves memory for an answer. The wait is short, as a request that waits keeps its permit.
    pub(crate) async fn room(&self, bytes: usize) -> Result<Share, ServerError> {
        let share = self.answers.share(bytes as u64);
        // Within the request's time, so that the client is told why.
        let most = WAIT_FOR_ROOM.min(self.limits.request_timeout.0 / 2);
        let in_time = tokio::time::timeout(most, share).await;
        in_time.unwrap_or_else(|_| {
            Err(ServerError::AnswerMemory {
                memory: self.limits.answer_memory,
                retry_after: self.limits.answer_idle_timeout,
            })
        })
    }

    /// The answer to a request whose time is over.
    pub(crate) fn timeout(&self) -> ServerError {
        ServerError::Timeout {
            limit: self.limits.request_timeout,
            retry_after: self.admission.retry_after(),
        }
    }

    /// The answer to new requests once the server was told to stop.
    pub(crate) fn draining(&self) -> ServerError {
        ServerError::Draining {
            retry_after: self.limits.shutdown_timeout,
        }
    }
}
