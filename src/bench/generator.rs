//! The engine as the bench uses it.

use bytes::Bytes;
use ndarray::Array2;

use super::{error::Result, options::BenchOptions};
use crate::{
    engine::{Engine, EngineConfig, GenerationOptions, GenerationRequest},
    formats::{Codes, GeneratedMotion},
};

/// An engine, and the song that it generates motion for.
pub(super) struct Generator {
    engine: Engine,
    pub(super) song: Bytes,
}

impl Generator {
    pub(super) fn open(options: &BenchOptions, threads: usize) -> Result<Self> {
        let engine = Engine::open(&EngineConfig {
            device: options.device,
            threads,
            queue: 64,
            ..EngineConfig::new(&options.model_dir)
        })?;
        let song = options.song.clone();
        Ok(Self { engine, song })
    }

    /// Generates motion for the song, with as many candidates as given, else the model's default.
    pub(super) fn song(&self, seed: u64, candidates: Option<usize>) -> Result<GeneratedMotion> {
        self.audio(self.song.clone(), seed, candidates)
    }

    /// Generates motion for another audio file.
    pub(super) fn audio(
        &self,
        audio: Bytes,
        seed: u64,
        candidates: Option<usize>,
    ) -> Result<GeneratedMotion> {
        let request = GenerationRequest::audio(audio, options(seed, candidates));
        let output = self.engine.generate(request)?;
        Ok(output.into_motion(self.engine.manifest()))
    }

    /// Generates the codes of feature rows.
    pub(super) fn rows(&self, rows: Array2<f32>, seed: u64) -> Result<Codes> {
        let request = GenerationRequest::features(rows, options(seed, Some(1)));
        Ok(self.engine.generate(request)?.codes)
    }
}

fn options(seed: u64, candidates: Option<usize>) -> GenerationOptions {
    GenerationOptions { seed: Some(seed), candidates, ..GenerationOptions::default() }
}
