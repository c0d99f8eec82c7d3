//! The engine as the bench uses it.

use std::sync::Arc;

use bytes::Bytes;
use ndarray::Array2;

use super::options::BenchOptions;
use crate::{
    CancelToken, Result,
    audio::AudioLimits,
    engine::{Choreographer, DEFAULT_BATCH, EngineConfig, GenerationOptions},
    formats::{Codes, GeneratedMotion},
};

/// An engine, and the song that it generates motion for.
pub(super) struct Generator {
    engine: Choreographer,
    pub(super) song: Bytes,
}

impl Generator {
    pub(super) fn open(options: &BenchOptions, threads: usize) -> Result<Self> {
        let engine = Choreographer::open(&EngineConfig {
            model_dir: options.model_dir.clone(),
            threads,
            batch: DEFAULT_BATCH.get(),
            queue: 64,
            audio: AudioLimits::default(),
            observer: Arc::new(()),
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
        let options = options(seed, candidates);
        self.engine.generate(audio, &options, &CancelToken::new())
    }

    /// Generates the codes of feature rows.
    pub(super) fn rows(&self, rows: Array2<f32>, seed: u64) -> Result<Codes> {
        let (options, never) = (options(seed, Some(1)), CancelToken::new());
        let raw = self
            .engine
            .dance_to_rows(rows, &options, &never, Arc::new(()))?;
        Ok(raw.codes)
    }
}

fn options(seed: u64, candidates: Option<usize>) -> GenerationOptions {
    GenerationOptions {
        seed: Some(seed),
        candidates,
        ..GenerationOptions::default()
    }
}
