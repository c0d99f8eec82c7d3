//! From the decoder's output to a finished motion: root, floor, rotations, frame rate.

use ndarray::ArrayView2;

use super::{
    Animation, InverseKinematics, MotionError, Positions, Skeleton, floor_correction, forward,
    integrate_root, leg::Legs, lower_foot_heights, resample,
};

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
    /// Joint positions `[frames, joints, 3]`, metres. The decoder's own have bones that stretch; the
    /// animation's feet follow theirs, and its root is within centimetres of theirs.
    pub positions: Positions,
    /// Where the positions come from.
    pub source: PositionsSource,
}

/// Finishes a decoder's output `[frames, 3 * joints]` (root velocity in columns 0..3, other joints
/// relative to the root, metres): the root starts at the skeleton's `root_height`, slow vertical
/// drift is removed, rotations are found, legs are bent to the decoder's feet, and the frame rate is
/// changed where another is wanted.
///
/// # Errors
/// [`MotionError::FrameRate`] for a rate that is not offered, [`MotionError::Shape`] if the columns
/// are not the skeleton's, [`MotionError::NotFinite`] for a NaN or an infinity.
pub fn finish(
    decoded: ArrayView2<'_, f32>,
    skeleton: &Skeleton,
    options: &FinishOptions,
) -> Result<Finished, MotionError> {
    let solver = InverseKinematics::new(skeleton)?;
    let decoded = integrate_root(decoded, [0.0, skeleton.root_height, 0.0])?;
    let mut solved = solver.solve(&decoded, options.decoded_fps)?;
    Legs::new(skeleton).follow(&mut solved, &decoded);
    let mut animation = resample(&solved, options.fps)?;
    if !options.root_motion {
        stay(&mut animation);
    }
    lift_animation(&mut animation, skeleton)?;
    let (positions, source) = if options.fps == options.decoded_fps {
        let positions = stand(decoded, skeleton, options);
        (positions, PositionsSource::Decoder)
    } else {
        let positions = forward(skeleton, &animation)?;
        (positions, PositionsSource::ForwardKinematics)
    };
    Ok(Finished {
        animation,
        positions,
        source,
    })
}

fn stay(animation: &mut Animation) {
    for root in &mut animation.root {
        (root.x, root.z) = (0.0, 0.0);
    }
}

/// Stands the skeleton on the floor by its own feet. They are where the decoder's are, but for legs
/// that cannot reach, so this is the decoder's correction to within millimetres.
fn lift_animation(animation: &mut Animation, skeleton: &Skeleton) -> Result<(), MotionError> {
    let heights = lower_foot_heights(&forward(skeleton, animation)?, skeleton);
    let lift = floor_correction(&heights, animation.fps);
    for (root, lift) in animation.root.iter_mut().zip(lift) {
        root.y += lift;
    }
    Ok(())
}

/// Stands the decoder's joints on the floor by their own feet.
fn stand(mut positions: Positions, skeleton: &Skeleton, options: &FinishOptions) -> Positions {
    let lift = floor_correction(&lower_foot_heights(&positions, skeleton), options.fps);
    for (mut pose, lift) in positions.outer_iter_mut().zip(lift) {
        let held = if options.root_motion {
            [0.0, 0.0]
        } else {
            [pose[[0, 0]], pose[[0, 2]]]
        };
        for mut joint in pose.outer_iter_mut() {
            joint[0] -= held[0];
            joint[1] += lift;
            joint[2] -= held[1];
        }
    }
    positions
}
