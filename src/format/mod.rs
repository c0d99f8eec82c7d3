//! Dances as files: JSON and BVH.

mod dance;
mod error;

pub use crate::motion::PositionsSource;
pub use dance::{Codes, Dance, MusicInfo, Timings};
pub use error::FormatError;
