//! Skeleton, root integration, rotations by inverse kinematics, forward kinematics, the floor,
//! and resampling of the frame rate.
//!
//! Metres, y up, right-handed; the rest pose faces +z with the left side at +x.

mod beats;
mod error;
mod facing;
mod finish;
mod finisher;
mod fit;
mod floor;
mod floor_line;
mod forward;
mod frame;
mod frames;
mod inverse;
mod leg;
mod resample;
mod root;
mod skeleton;
mod smooth;
#[cfg(test)]
mod tests;
mod two_bones;

pub use beats::{beat_meeting, beat_nearness, dance_beats, joint_speed, slow_share, smoothed};
pub use error::MotionError;
pub use facing::{facing_columns, facings, to_dancer_frame, to_world_frame};
pub use finish::{FinishOptions, Finished, PositionsSource, finish, finish_while};
pub use finisher::Finisher;
pub use floor::{STANDING_HEIGHT, floor_correction, lower_foot_heights};
pub use forward::forward;
pub use frame::{MotionFrame, ToWorld};
pub use inverse::InverseKinematics;
pub use resample::{FRAME_RATES, resample};
pub use root::integrate_root;
pub use skeleton::Skeleton;

use glam::{Quat, Vec3};
use ndarray::Array3;

/// Joint positions in metres, world space: `[frames, joints, 3]`.
pub type Positions = Array3<f32>;

/// A motion as local rotations on a skeleton.
#[derive(Clone, Debug, PartialEq)]
pub struct Animation {
    /// Frames per second.
    pub fps: u32,
    /// World position of the root joint, one per frame, metres.
    pub root: Vec<Vec3>,
    /// Local unit quaternions, `[frame][joint]`, sign-continuous along time.
    pub rotations: Vec<Vec<Quat>>,
}
