//! The generation loop and its schedule; knows no HTTP.

mod choreographer;
mod error;
mod options;

pub use choreographer::{Choreographer, EngineConfig};
pub use error::EngineError;
pub use options::GenerationOptions;
