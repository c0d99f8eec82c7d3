//! Poses turned towards +z, so that they can be compared and seen whatever their heading.

use glam::{Quat, Vec3};
use ndarray::Array3;

use crate::{half::Half, pose::Pose};
use bailando_motion::headings;

/// Turns each half of `pose` towards +z alone, and returns the headings `[upper, lower]` that the
/// halves had.
///
/// A code says what its half does. In the world's frame it has any heading, and the other half's
/// code another.
pub(crate) fn halves_to_front(pose: &[[f32; 3]], upper_joints: &[usize]) -> (Pose, [f32; 2]) {
    let half = |joint: usize| Half::of_joint(joint, upper_joints);
    let headings = Half::BOTH.map(|wanted| heading(pose, |joint| half(joint) == wanted));
    let joints = pose.iter().enumerate();
    let turned = joints.map(|(joint, &place)| turned(place, -half(joint).of(&headings)));
    (turned.collect(), headings)
}

/// Turns whole bodies by one angle, which brings the first to face +z.
pub(crate) fn bodies_to_front(poses: &[Pose]) -> Vec<Pose> {
    let first = poses.first().map_or(0.0, |pose| heading(pose, |_| true));
    let front = |pose: &Pose| pose.iter().map(|&place| turned(place, -first)).collect();
    poses.iter().map(front).collect()
}

/// Returns the heading of some joints of a pose. The others move to the origin, where they say
/// nothing about it.
fn heading(pose: &[[f32; 3]], inside: impl Fn(usize) -> bool) -> f32 {
    let positions =
        Array3::from_shape_fn((1, pose.len(), 3), |(_, joint, axis)| match inside(joint) {
            true => pose[joint][axis],
            false => 0.0,
        });
    headings(&positions)[0]
}

fn turned(place: [f32; 3], angle: f32) -> [f32; 3] {
    (Quat::from_rotation_y(angle) * Vec3::from(place)).to_array()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hips and shoulders of SMPL, and a hand in front of the chest.
    fn body() -> Pose {
        let mut pose = vec![[0.0; 3]; 24];
        pose[1] = [0.1, 0.0, 0.0];
        pose[2] = [-0.1, 0.0, 0.0];
        pose[16] = [0.2, 0.5, 0.0];
        pose[17] = [-0.2, 0.5, 0.0];
        pose[23] = [0.0, 0.4, 0.3];
        pose
    }

    fn turn(pose: &Pose, [upper, lower]: [f32; 2]) -> Pose {
        let angle = |joint| if joint >= 12 { upper } else { lower };
        let joints = pose.iter().enumerate();
        joints.map(|(joint, &place)| turned(place, angle(joint))).collect()
    }

    fn assert_close(found: &Pose, expected: &Pose) {
        for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
    }

    #[test]
    fn halves_come_to_face_the_front_each_by_its_own_turn() {
        let upper: Vec<usize> = (12..24).collect();
        let (front, angles) = halves_to_front(&turn(&body(), [2.0, -1.0]), &upper);
        let close = (angles[0] - 2.0).abs() < 1e-5 && (angles[1] + 1.0).abs() < 1e-5;
        assert!(close, "{angles:?}");
        assert_close(&front, &body());
    }

    #[test]
    fn bodies_turn_with_the_first() {
        let front = bodies_to_front(&[turn(&body(), [1.0; 2]), turn(&body(), [1.5; 2])]);
        assert_close(&front[0], &body());
        assert_close(&front[1], &turn(&body(), [0.5; 2]));
    }
}
