//! What all handlers share.

use std::sync::{Arc, OnceLock};

use bytes::Bytes;

use super::{
    admission::Admission,
    config::{Limits, Seconds},
    error::ServerError,
    info::Info,
    lifecycle::Lifecycle,
};
use crate::{
    CancelToken, Result,
    engine::{Choreographer, EngineError, GenerationOptions},
    format::Dance,
    model::Manifest,
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

    /// Generates one dance. Blocks.
    ///
    /// # Errors
    /// Any [`crate::Error`]; soon after `cancel` is triggered, [`EngineError::Cancelled`].
    fn generate(
        &self,
        audio: Bytes,
        options: &GenerationOptions,
        cancel: &CancelToken,
    ) -> Result<Dance>;
}

impl Generate for Choreographer {
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

    fn generate(
        &self,
        audio: Bytes,
        options: &GenerationOptions,
        cancel: &CancelToken,
    ) -> Result<Dance> {
        self.generate(audio, options, cancel)
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
    pub(crate) admission: Arc<Admission>,
    pub(crate) lifecycle: Lifecycle,
}

/// What there is once the model has been loaded.
pub(crate) struct Loaded {
    pub(crate) engine: Arc<dyn Generate>,
    pub(crate) info: Info,
}

impl ServerState {
    /// Without a model yet.
    pub(crate) fn loading(limits: Limits) -> SharedState {
        Arc::new(Self {
            loaded: OnceLock::new(),
            admission: Admission::new(&limits),
            lifecycle: Lifecycle::default(),
            limits,
        })
    }

    pub(crate) fn new(engine: Arc<dyn Generate>, limits: Limits) -> SharedState {
        let state = Self::loading(limits);
        state.finish_loading(engine);
        state
    }

    /// Takes the model; a second one changes nothing.
    pub(crate) fn finish_loading(&self, engine: Arc<dyn Generate>) {
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

    /// The answer to new requests once the server was told to stop.
    pub(crate) fn draining(&self) -> ServerError {
        ServerError::Draining {
            retry_after: self.limits.shutdown_timeout,
        }
    }
}
