//! Dances as files: JSON and BVH.

mod bvh;
mod dance;
mod decimal;
mod error;
mod euler;
mod events;
mod json;
mod numbers;
mod output;
mod pose;
mod tail;

pub use bailando_motion::PositionsSource;
pub use bvh::{BvhUnit, to_bvh};
pub use dance::{Codes, Dance, MusicInfo, Timings};
pub use error::FormatError;
pub use events::{DoneJson, FramesJson, Start, StartJson, done_event, frames_event, start_event};
pub use json::{
    CodesJson, DanceJson, Encoding, JsonOptions, MusicJson, SkeletonJson, SourceJson, TimingsJson,
    to_json,
};
pub use output::OutputFormat;
pub use pose::{CodePoseJson, pose_json};
pub use tail::Tail;
