//! A model that is described and not run: what a server needs that only takes jobs.

use crate::{
    engine::{
        EngineConfig, EngineError, Generation, GenerationOptions, GenerationRequest, Pending,
        check_options,
    },
    model::{Manifest, ModelDirectory},
    motion::Positions,
    server::state::Generate,
};

/// A model directory without sessions and threads.
pub(crate) struct ModelDescription {
    directory: ModelDirectory,
    rows: usize,
}

impl ModelDescription {
    /// Reads and checks the directory of the settings.
    ///
    /// # Errors
    /// [`EngineError::Model`].
    pub(crate) fn open(config: &EngineConfig) -> Result<Self, EngineError> {
        let directory = ModelDirectory::open(&config.model_dir)?;
        Ok(Self { directory, rows: config.batch })
    }
}

impl Generate for ModelDescription {
    fn manifest(&self) -> &Manifest {
        self.directory.manifest()
    }

    fn model_sha256(&self) -> &str {
        self.directory.manifest_sha256()
    }

    fn check(&self, options: &GenerationOptions) -> Result<(), EngineError> {
        check_options(options, self.manifest(), self.model_sha256(), self.rows)
    }

    /// No route that needs it is served.
    fn submit(&self, request: GenerationRequest) -> Generation {
        drop(request);
        Generation::ready(Err(EngineError::Stopped))
    }

    fn pose(&self, _: [u32; 2]) -> Pending<Positions> {
        Pending::ready(Err(EngineError::Stopped))
    }
}
