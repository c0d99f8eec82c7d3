//! The generation loop and its schedule; knows no HTTP.

mod choreographer;
mod error;
mod generator;
mod options;
mod progress;
mod sampler;
mod window;
mod worker;

pub use choreographer::{Choreographer, EngineConfig, RawDance};
pub use error::EngineError;
pub use options::{GenerationOptions, MAX_TEMPERATURE};
pub use progress::{Progress, Stage};
pub use sampler::MAX_SEED;
