//! Dances as files: JSON and BVH.

mod dance;
mod error;

pub use dance::{Codes, Dance, MusicInfo, PositionsSource, Timings};
pub use error::FormatError;
