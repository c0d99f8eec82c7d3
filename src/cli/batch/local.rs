//! Dances made by this process.

use std::{num::NonZeroUsize, path::Path};

use bailando::{
    engine::{Engine, EngineConfig, GenerationRequest, MAX_CANDIDATES},
    formats::OutputFormat,
    options::RequestOptions,
};
use bytes::Bytes;

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
            device: args.device,
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
        let audio = Bytes::from(read_file(song)?);
        let dance = self.options.dance(self.format, |options| {
            let output = self.engine.generate(GenerationRequest::audio(audio.clone(), options))?;
            anyhow::Ok(output.into_motion(self.engine.manifest()))
        })?;
        write_file(result, self.format.write(&dance, &self.options.writing())?)
    }
}
