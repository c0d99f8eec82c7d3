//! Engines, and the motion that they make of songs.

use std::{path::Path, sync::LazyLock};

use bailando::{
    engine::{Engine, EngineConfig, GenerationOptions, GenerationRequest},
    formats::GeneratedMotion,
};
use bailando_testkit::model::tiny_dancer;
use ndarray::Array2;

/// A tiny model with all that a model can have, loaded once.
pub(crate) static TINY: LazyLock<Engine> = LazyLock::new(|| open(&tiny_dancer()));

/// Loads a model with places for all that tests submit at once.
pub(crate) fn open(model: &Path) -> Engine {
    Engine::open(&EngineConfig { threads: 2, queue: 64, ..EngineConfig::new(model) }).unwrap()
}

/// The motion to a song.
pub(crate) fn dance_to(
    engine: &Engine,
    audio: Vec<u8>,
    options: &GenerationOptions,
) -> GeneratedMotion {
    let request = GenerationRequest::audio(audio, options.clone());
    engine.generate(request).unwrap().into_motion(engine.manifest())
}

/// The motion of several requests, which share the model's steps.
pub(crate) fn dances(
    engine: &Engine,
    requests: impl Iterator<Item = GenerationRequest>,
) -> Vec<GeneratedMotion> {
    let running: Vec<_> = requests.map(|request| engine.submit(request)).collect();
    let outputs = running.into_iter().map(|generation| generation.wait().unwrap());
    outputs.map(|output| output.into_motion(engine.manifest())).collect()
}

/// Music of no song.
pub(crate) fn music(rows: usize, columns: usize) -> Array2<f32> {
    Array2::from_shape_fn((rows, columns), |(row, column)| {
        ((row * 31 + column * 7) % 97) as f32 / 97.0 - 0.5
    })
}
