//! Forward kinematics: local rotations on the rest skeleton to joint positions.

use glam::{Quat, Vec3};

use super::{Animation, MotionError, Positions, Skeleton};

/// World positions `[frames, joints, 3]` in metres of an animation on a skeleton.
///
/// # Errors
/// [`MotionError::Skeleton`] if the skeleton contradicts itself, [`MotionError::Shape`] if the
/// animation does not have one root and one rotation per joint in every frame.
pub fn forward(skeleton: &Skeleton, animation: &Animation) -> Result<Positions, MotionError> {
    skeleton.validate()?;
    let joints = skeleton.joints.len();
    let frames = animation.rotations.len();
    if animation.root.len() != frames || animation.rotations.iter().any(|r| r.len() != joints) {
        return Err(MotionError::Shape {
            expected: format!("one root and {joints} rotations in every frame"),
            got: format!(
                "{} roots, {frames} frames of rotations",
                animation.root.len()
            ),
        });
    }
    let mut positions = Positions::zeros((frames, joints, 3));
    let mut turned = vec![Quat::IDENTITY; joints];
    let mut places = vec![Vec3::ZERO; joints];
    let poses = animation.root.iter().zip(&animation.rotations);
    for ((&root, rotations), mut pose) in poses.zip(positions.outer_iter_mut()) {
        for (joint, &local) in rotations.iter().enumerate() {
            (places[joint], turned[joint]) = match skeleton.parent(joint) {
                None => (root, local),
                Some(parent) => {
                    let offset = Vec3::from_array(skeleton.offsets[joint]);
                    let place = places[parent] + turned[parent] * offset;
                    (place, (turned[parent] * local).normalize())
                }
            };
            for (cell, value) in pose.row_mut(joint).iter_mut().zip(places[joint].to_array()) {
                *cell = value;
            }
        }
    }
    Ok(positions)
}
