//! Schedules generations; knows no HTTP.
//!
//! A request's way: [`Engine::submit`] checks its options → a frontend thread decodes the song and
//! computes its features (`frontend`, `prepare`) → the scheduler's thread chooses code pairs, one
//! step for all running requests (`scheduler`, `sequence`) → the decoder's thread makes motion of
//! each chunk of codes and finishes it (`decoding`) → the future of the caller. Codes that the
//! caller gives go to the decoder's thread from the frontend (`given`).

mod chunk_decoder;
mod chunks;
mod code_model;
mod completion;
mod conditioning;
mod decoding;
mod effort;
#[expect(clippy::module_inception, reason = "the engine itself is its largest part")]
mod engine;
mod error;
#[cfg(test)]
mod fake;
mod form;
mod frontend;
mod given;
mod guidance;
mod observer;
mod options;
mod pool;
mod pose;
mod prepare;
mod progress;
mod prompt;
mod queue;
mod request;
mod sampler;
mod scheduler;
mod scorer;
mod segment;
mod self_test;
mod sequence;
mod start_codes;
mod threads;
mod window;

pub use crate::model::{MAX_CANDIDATES, MAX_GUIDANCE, MAX_TEMPERATURE};
pub use completion::{Generation, Pending};
pub use effort::DecodeEffort;
pub use engine::{DEFAULT_BATCH, Engine, EngineConfig, check_options};
pub use error::EngineError;
pub use observer::Observer;
pub use options::GenerationOptions;
pub(crate) use options::accepted_styles;
pub use progress::{MotionStream, Opening, Progress, Stage};
pub use request::{GenerationOutput, GenerationRequest, MotionOutput, MusicSource};
pub use sampler::MAX_SEED;
