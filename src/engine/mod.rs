//! The generation loop and its schedule; knows no HTTP.

mod batch;
mod choreographer;
mod chunk_decoder;
mod chunks;
mod ears;
mod error;
mod frames;
mod guidance;
mod observer;
mod options;
mod piece;
mod progress;
mod queue;
mod reply;
mod sampler;
mod search;
mod sessions;
mod song;
mod tail;
mod window;
mod worker;

pub use crate::model::{MAX_CANDIDATES, MAX_GUIDANCE, MAX_TEMPERATURE};
pub use choreographer::{Choreographer, DEFAULT_BATCH, Ending, EngineConfig, RawDance};
pub use error::EngineError;
pub use observer::Observer;
pub use options::GenerationOptions;
pub use progress::{Listener, Opening, Progress, Stage};
pub use sampler::MAX_SEED;
