//! Motion of a skeleton: from a decoder's output to rotations and positions that stand on the
//! floor.
//!
//! Metres, y up, right-handed; the rest pose faces +z with the left side at +x. [`finish`] runs the
//! whole chain on one motion, [`Finisher`] on a motion that is still being decoded.
//!
//! ```
//! use bailando_motion::{FinishOptions, Skeleton, finish};
//!
//! let skeleton = Skeleton {
//!     joints: vec!["pelvis".into(), "l_foot".into()],
//!     parents: vec![-1, 0],
//!     offsets: vec![[0.0; 3], [0.0, -0.9, 0.1]],
//!     root_height: 0.9,
//! };
//! // Two seconds at 60 frames a second: root velocity, then the foot relative to the root.
//! let frame = [0.01, 0.0, 0.0, 0.0, -0.9, 0.1];
//! let decoded = ndarray::Array2::from_shape_fn((120, 6), |(_, column)| frame[column]);
//! let options = FinishOptions { fps: 30, ..FinishOptions::default() };
//! let motion = finish(decoded.view(), &skeleton, &options)?;
//! assert_eq!(motion.positions.dim(), (60, 2, 3));
//! // The foot joint of a standing dancer is 1.5 cm above the floor.
//! assert!((motion.positions[[0, 1, 1]] - 0.015).abs() < 1e-3);
//! # Ok::<(), bailando_motion::MotionError>(())
//! ```

mod animation;
mod beats;
mod clean;
mod error;
mod finish;
mod fit;
mod floor;
mod floor_tracker;
mod forward;
mod frame;
mod heading;
mod inverse;
mod leg;
mod legs;
mod looping;
mod mirror;
mod resample;
mod retarget;
mod root;
mod seam;
mod skeleton;
mod smooth;
mod two_bones;

pub use animation::{Animation, Positions};
pub use beats::{
    beat_align_score, dance_beats, joint_speed, mutual_beat_alignment, slow_share, smoothed,
};
pub use error::MotionError;
pub use finish::{FinishOptions, Finished, Finisher, PositionsSource, finish, finish_while};
pub use floor::{STANDING_HEIGHT, floor_correction, lower_foot_heights};
pub use forward::forward;
pub use frame::{MotionFrame, ToWorld};
pub use heading::{headings, to_dancer_frame, to_world_frame};
pub use inverse::InverseKinematics;
pub use looping::{best_loop, close_loop};
pub use resample::{FRAME_RATES, resample};
pub use retarget::{BodyPart, Figure, FigureBone, Retargeted, Retargeter, Side};
pub use root::integrate_root;
pub use seam::Seam;
pub use skeleton::Skeleton;
