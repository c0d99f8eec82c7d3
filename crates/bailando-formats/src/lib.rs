//! Generated motion as files: JSON, BVH, GLB, VRM animation, FBX, VMD and npz.
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
//!     style: None,
//!     music: None,
//!     timings: Timings::default(),
//!     warnings: Vec::new(),
//!     song_start_s: 0.0,
//!     continuation: None,
//! };
//! let bytes = to_json(&motion, &JsonOptions::default())?;
//! let json: serde_json::Value = serde_json::from_slice(&bytes)?;
//! assert_eq!(json["positions"][0][0][1], 1.0);
//! let bvh = to_bvh(&motion, BvhUnit::Metre)?;
//! assert!(bvh.ends_with("0.000000 1.000000 0.000000 0.0000 0.0000 0.0000\n"));
//! # Ok::<(), bailando_formats::FormatError>(())
//! ```

mod blob;
mod bvh;
mod character;
mod codes;
mod continuation;
mod decimal;
mod error;
mod euler;
mod events;
mod fbx;
mod glb;
mod gltf;
mod json;
mod keys;
mod looped;
mod mannequin;
mod motion;
mod npz;
mod numbers;
mod output;
mod pose;
mod rig;
mod stored;
mod target;
mod vmd;
mod vrma;

pub use bailando_motion::PositionsSource;
pub use bvh::{BvhUnit, to_bvh, to_bvh_for};
pub use character::{BoneNames, Character, FoundBy, RigFormat, RigLimits, RigMapping};
pub use codes::{Codes, NoCodes};
pub use continuation::Continuation;
pub use error::FormatError;
pub use events::{DoneJson, FramesJson, Start, StartJson, done_event, frames_event, start_event};
pub use fbx::to_fbx;
pub use glb::{GlbOptions, to_glb};
pub use json::{JsonOptions, MotionJson, SkeletonJson, to_json};
pub use looped::{LoopOptions, LoopSearch, MOST_LOOP_DANCES};
pub use motion::{GeneratedMotion, MotionSize, MusicInfo, Timings};
pub use npz::to_npz;
pub use numbers::Encoding;
pub use output::{OutputFormat, WriteOptions};
pub use pose::{CodePoseJson, pose_json};
pub use stored::{from_stored, stored_bytes, to_stored};
pub use target::TargetSkeleton;
pub use vmd::to_vmd;
pub use vrma::to_vrma;
