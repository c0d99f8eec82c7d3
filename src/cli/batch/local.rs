//! Dances made by this process.

use std::{num::NonZeroUsize, path::Path};

use bailando::{
    engine::{Engine, EngineConfig, GenerationRequest, MAX_CANDIDATES},
    formats::OutputFormat,
    options::RequestOptions,
};

use super::{args::BatchArgs, dancer::Dancer};
use crate::cli::console::{read_file, write_file};

pub(super) struct Local {
    engine: Engine,
    options: RequestOptions,
    format: OutputFormat,
}

impl Local {
    pub(super) fn open(args: &BatchArgs) -> anyhow::Result<Self> {
        let defaults = EngineConfig::new(&args.model_dir);
        let engine = Engine::open(&EngineConfig {
            threads: args.threads.map_or(defaults.threads, NonZeroUsize::get),
            batch: defaults.batch.max(2 * MAX_CANDIDATES),
            queue: args.at_once.get(),
            songs: args.at_once.get(),
            ..defaults
        })?;
        engine.check(&args.options.generation(args.format))?;
        Ok(Self { engine, options: args.options.clone(), format: args.format })
    }
}

impl Dancer for Local {
    fn dance(&self, song: &Path, result: &Path) -> anyhow::Result<()> {
        let options = self.options.generation(self.format);
        let request = GenerationRequest::audio(read_file(song)?, options);
        let dance = self.engine.generate(request)?.into_motion(self.engine.manifest());
        let dance = self.options.looped(dance)?;
        write_file(result, self.format.write(&dance, &self.options.writing())?)
    }
}
