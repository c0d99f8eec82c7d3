//! From the decoder's output to a finished motion: root, floor, rotations, frame rate.

use ndarray::ArrayView2;

use super::{
    Animation, InverseKinematics, MotionError, Positions, Skeleton, floor_correction, forward,
    integrate_root, lower_foot_heights, resample,
};

/// Furthest that the floor is moved away from the decoder's feet towards the skeleton's, metres.
const SKELETON_SHARE: f32 = 0.02;

/// What a motion is finished to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FinishOptions {
    /// Frames per second wanted: one of [`super::FRAME_RATES`].
    pub fps: u32,
    /// Whether the dancer travels; `false` holds x and z of the root at 0 and keeps y.
    pub root_motion: bool,
    /// Frames per second of the decoder's output.
    pub decoded_fps: u32,
}

impl Default for FinishOptions {
    fn default() -> Self {
        Self {
            fps: 60,
            root_motion: true,
            decoded_fps: 60,
        }
    }
}

/// Where a dance's positions come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PositionsSource {
    /// The decoder's own positions, at its own frame rate.
    Decoder,
    /// Forward kinematics of resampled rotations.
    ForwardKinematics,
}

/// A motion that stands on the floor y = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Finished {
    /// Rotations and root on the rest skeleton, at the wanted frame rate.
    pub animation: Animation,
    /// Joint positions `[frames, joints, 3]`, metres; joint 0 is the animation's root.
    pub positions: Positions,
    /// Where the positions come from.
    pub source: PositionsSource,
}

/// Finishes a decoder's output `[frames, 3 * joints]` (root velocity in columns 0..3, other joints
/// relative to the root, metres): the root starts at the skeleton's `root_height`, slow vertical
/// drift is removed, rotations are found, and the frame rate is changed where another is wanted.
///
/// # Errors
/// [`MotionError::FrameRate`] for a rate that is not offered, [`MotionError::Shape`] if the columns
/// are not the skeleton's, [`MotionError::NotFinite`] for a NaN or an infinity.
#[expect(
    clippy::needless_pass_by_value,
    reason = "a view is a reference already"
)]
pub fn finish(
    decoded: ArrayView2<'_, f32>,
    skeleton: &Skeleton,
    options: &FinishOptions,
) -> Result<Finished, MotionError> {
    let solver = InverseKinematics::new(skeleton)?;
    let decoded = integrate_root(decoded, [0.0, skeleton.root_height, 0.0])?;
    let mut animation = resample(&solver.solve(&decoded, options.decoded_fps)?, options.fps)?;
    let on_skeleton = forward(skeleton, &animation)?;
    let mut heights = lower_foot_heights(&on_skeleton, skeleton);
    let (mut positions, source) = if options.fps == options.decoded_fps {
        heights = between(&lower_foot_heights(&decoded, skeleton), &heights);
        (decoded, PositionsSource::Decoder)
    } else {
        (on_skeleton, PositionsSource::ForwardKinematics)
    };
    let lift = floor_correction(&heights, options.fps);
    move_root(&mut positions, &mut animation, &lift, options.root_motion);
    Ok(Finished {
        animation,
        positions,
        source,
    })
}

/// Foot heights between the decoder's and the skeleton's, whose legs are a little longer or shorter.
/// Both results are handed out (the decoder's positions, the rotations as BVH): with the floor between
/// the two, each stands on it.
fn between(decoder: &[f32], skeleton: &[f32]) -> Vec<f32> {
    decoder
        .iter()
        .zip(skeleton)
        .map(|(d, s)| d + (0.5 * (s - d)).clamp(-SKELETON_SHARE, SKELETON_SHARE))
        .collect()
}

/// Lifts root and joints, and holds the root at x = z = 0 if it shall not travel.
fn move_root(positions: &mut Positions, animation: &mut Animation, lift: &[f32], travels: bool) {
    let frames = animation.root.iter_mut().zip(positions.outer_iter_mut());
    for ((root, mut pose), &lift) in frames.zip(lift) {
        let held = if travels {
            [0.0, 0.0]
        } else {
            [root.x, root.z]
        };
        for mut joint in pose.outer_iter_mut() {
            joint[0] -= held[0];
            joint[1] += lift;
            joint[2] -= held[1];
        }
        *root = [pose[[0, 0]], pose[[0, 1]], pose[[0, 2]]].into();
    }
}
