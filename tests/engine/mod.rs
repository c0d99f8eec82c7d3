//! The engine over the tiny models: golden samplings, requests side by side, given codes,
//! models that are refused.

mod batching;
mod dancer_frame;
mod given;
mod refusals;
mod sampling;
mod styles;

use std::path::{Path, PathBuf};

use bailando::engine::{Engine, EngineConfig, EngineError};
use bailando_testkit::fixture;

/// Loads a model on one thread, with one place in the queue.
fn open(model: &Path) -> Result<Engine, EngineError> {
    Engine::open(&EngineConfig { threads: 1, ..EngineConfig::new(model) })
}

/// Path of a golden file.
fn golden(name: &str) -> PathBuf {
    fixture("model").join(name)
}
