//! Skeleton, root integration, rotations by inverse kinematics, forward kinematics, the floor,
//! and resampling of the frame rate.

mod error;
mod skeleton;

pub use error::MotionError;
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
