//! Audio in, dance out: the one path that the server and the command line share.

use std::{path::PathBuf, sync::Arc};

use bytes::Bytes;

use super::{EngineError, GenerationOptions};
use crate::{CancelToken, Result, audio::AudioLimits, format::Dance, model::Manifest};

/// What a [`Choreographer`] needs to start.
#[derive(Clone, Debug)]
pub struct EngineConfig {
    /// The model directory.
    pub model_dir: PathBuf,
    /// Threads that ONNX Runtime computes one step with.
    pub threads: usize,
    /// Generations that may wait for the model.
    pub queue: usize,
    /// What an upload may ask of the decoder.
    pub audio: AudioLimits,
}

/// Handle to a loaded model; clones share it.
#[derive(Clone, Debug)]
pub struct Choreographer {
    manifest: Arc<Manifest>,
}

impl Choreographer {
    /// Loads the model directory and starts its thread.
    ///
    /// # Errors
    /// [`crate::model::ModelError`] says which file of the directory is wrong and why.
    pub fn open(_config: &EngineConfig) -> Result<Self> {
        Err(EngineError::Stopped.into())
    }

    /// The loaded model's manifest.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Checks `options` against the model without any work.
    ///
    /// # Errors
    /// [`EngineError::Option`] names the first option that does not fit.
    pub fn check(&self, _options: &GenerationOptions) -> Result<(), EngineError> {
        Ok(())
    }

    /// Generates one dance. Blocks: decoding and features run on the calling thread, the model on
    /// its own.
    ///
    /// # Errors
    /// Any [`crate::Error`]; [`EngineError::Cancelled`] soon after `cancel` is triggered.
    pub fn generate(
        &self,
        _audio: Bytes,
        _options: &GenerationOptions,
        _cancel: &CancelToken,
    ) -> Result<Dance> {
        Err(EngineError::Stopped.into())
    }
}
