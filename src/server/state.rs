//! What all handlers share.

use std::sync::Arc;

use bytes::Bytes;

use super::{admission::Admission, config::Limits, info::Info, lifecycle::Lifecycle};
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

/// Handle to what all handlers share.
pub(crate) type SharedState = Arc<ServerState>;

/// What all handlers share.
pub(crate) struct ServerState {
    pub(crate) engine: Arc<dyn Generate>,
    pub(crate) limits: Limits,
    pub(crate) admission: Arc<Admission>,
    pub(crate) lifecycle: Lifecycle,
    pub(crate) info: Info,
}

impl ServerState {
    pub(crate) fn new(engine: Arc<dyn Generate>, limits: Limits) -> SharedState {
        Arc::new(Self {
            info: Info::new(engine.as_ref(), &limits),
            admission: Admission::new(&limits),
            lifecycle: Lifecycle::default(),
            engine,
            limits,
        })
    }
}
