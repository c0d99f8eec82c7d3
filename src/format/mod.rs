//! Dances as files: JSON and BVH.

mod bvh;
mod dance;
mod error;
mod euler;
mod json;
mod numbers;
mod output;

pub use crate::motion::PositionsSource;
pub use bvh::{BvhUnit, to_bvh};
pub use dance::{Codes, Dance, MusicInfo, Timings};
pub use error::FormatError;
pub use json::{
    CodesJson, DanceJson, Encoding, JsonOptions, MusicJson, SkeletonJson, SourceJson, TimingsJson,
    to_json,
};
pub use output::OutputFormat;
