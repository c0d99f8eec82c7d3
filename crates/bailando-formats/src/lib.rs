//! Generated motion as files: JSON and BVH.
//!
//! ```
//! use bailando_formats::{
//!     BvhUnit, Codes, GeneratedMotion, JsonOptions, PositionsSource, Timings, to_bvh, to_json,
//! };
//! use bailando_motion::{Animation, Skeleton};
//!
//! let motion = GeneratedMotion {
//!     model: "still".into(),
//!     seed: 1,
//!     skeleton: Skeleton {
//!         joints: vec!["pelvis".into()],
//!         parents: vec![-1],
//!         offsets: vec![[0.0; 3]],
//!         root_height: 0.9,
//!     },
//!     animation: Animation {
//!         fps: 60,
//!         root: vec![glam::Vec3::Y],
//!         rotations: vec![vec![glam::Quat::IDENTITY]],
//!     },
//!     positions: ndarray::array![[[0.0, 1.0, 0.0]]],
//!     positions_source: PositionsSource::Decoder,
//!     codes: Codes::default(),
//!     music: None,
//!     timings: Timings::default(),
//!     warnings: Vec::new(),
//!     continuation: None,
//! };
//! let bytes = to_json(&motion, &JsonOptions::default())?;
//! let json: serde_json::Value = serde_json::from_slice(&bytes)?;
//! assert_eq!(json["positions"][0][0][1], 1.0);
//! let bvh = to_bvh(&motion, BvhUnit::Metre)?;
//! assert!(bvh.ends_with("0.000000 1.000000 0.000000 0.0000 0.0000 0.0000\n"));
//! # Ok::<(), bailando_formats::FormatError>(())
//! ```

mod bvh;
mod codes;
mod continuation;
mod decimal;
mod error;
mod euler;
mod events;
mod json;
mod motion;
mod numbers;
mod output;
mod pose;

pub use bailando_motion::PositionsSource;
pub use bvh::{BvhUnit, to_bvh};
pub use codes::Codes;
pub use continuation::Continuation;
pub use error::FormatError;
pub use events::{DoneJson, FramesJson, Start, StartJson, done_event, frames_event, start_event};
pub use json::{JsonOptions, MotionJson, SkeletonJson, to_json};
pub use motion::{GeneratedMotion, MusicInfo, Timings};
pub use numbers::Encoding;
pub use output::OutputFormat;
pub use pose::{CodePoseJson, pose_json};
