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
    most_seconds: f64,
}

impl ModelDescription {
    /// Reads and checks the directory of the settings.
    ///
    /// # Errors
    /// [`EngineError::Model`].
    pub(crate) fn open(config: &EngineConfig) -> Result<Self, EngineError> {
        let directory = ModelDirectory::open(&config.model_dir)?;
        Ok(Self { directory, rows: config.batch, most_seconds: config.audio.max_seconds })
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
        let Self { directory, rows, most_seconds } = self;
        let (manifest, model) = (directory.manifest(), directory.manifest_sha256());
        check_options(options, manifest, model, *rows, *most_seconds)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::Codes;

    #[test]
    fn codes_that_no_worker_accepts_are_refused_with_their_length() {
        let mut config = EngineConfig::new(bailando_testkit::model::tiny());
        config.audio.max_seconds = 2.0;
        let model = ModelDescription::open(&config).unwrap();
        let check = |seconds: usize| {
            let codes = vec![1; (model.manifest().codes_per_second() * seconds as f64) as usize];
            let codes = Some(Codes { upper: codes.clone(), lower: codes });
            model.check(&GenerationOptions { codes, ..GenerationOptions::default() })
        };
        assert!(check(2).is_ok());
        let said = check(4).unwrap_err().to_string();
        assert!(said.contains("they last 4.0 s, and at most 2 s are accepted"), "{said}");
    }
}
