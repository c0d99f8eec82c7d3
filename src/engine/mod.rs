//! The generation loop and its schedule; knows no HTTP.

mod dance;
mod error;
mod options;

pub use dance::{Codes, Dance, MusicInfo, PositionsSource, Timings};
pub use error::EngineError;
pub use options::GenerationOptions;
