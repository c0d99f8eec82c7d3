//! Forward kinematics: local rotations on the rest skeleton to joint positions.

use glam::{Quat, Vec3};
use ndarray::aview1;

use crate::{
    animation::{Animation, Positions},
    error::MotionError,
    skeleton::Skeleton,
};

/// Returns the world positions `[frames, joints, 3]` in metres of an animation on a skeleton.
///
/// # Errors
/// [`MotionError::Skeleton`] if the skeleton contradicts itself, [`MotionError::Shape`] if the
/// animation does not have one root and one rotation per joint in every frame.
pub fn forward(skeleton: &Skeleton, animation: &Animation) -> Result<Positions, MotionError> {
    skeleton.validate()?;
    let joints = skeleton.joints.len();
    let frames = animation.rotations.len();
    let roots = animation.root.len();
    if roots != frames || animation.rotations.iter().any(|r| r.len() != joints) {
        return Err(MotionError::Shape {
            expected: format!("one root and {joints} rotations in every frame"),
            got: format!("{roots} roots, {frames} frames of rotations"),
        });
    }
    let mut positions = Positions::zeros((frames, joints, 3));
    let mut world = vec![(Vec3::ZERO, Quat::IDENTITY); joints];
    let poses = animation.root.iter().zip(&animation.rotations);
    for ((&root, rotations), mut pose) in poses.zip(positions.outer_iter_mut()) {
        for (joint, &local) in rotations.iter().enumerate() {
            world[joint] = match skeleton.parent(joint) {
                None => (root, local),
                Some(parent) => {
                    let (position, rotation) = world[parent];
                    let position = position + rotation * skeleton.offset(joint);
                    (position, (rotation * local).normalize())
                }
            };
            pose.row_mut(joint).assign(&aview1(&world[joint].0.to_array()));
        }
    }
    Ok(positions)
}
