//! Turning poses to face +z, so that what they do can be compared and seen.

use glam::{Quat, Vec3};
use ndarray::Array3;

use super::{Half, still::Pose};
use bailando_motion::headings;

/// Turns each half of `pose` to face +z by itself, and says how far the halves were turned away.
///
/// A code says what its half does; in the world's frame it faces anywhere, and so does its
/// companion.
pub(super) fn halves_to_front(pose: &[[f32; 3]], upper_joints: &[usize]) -> (Pose, [f32; 2]) {
    let is_upper = |joint: usize| upper_joints.contains(&joint);
    let angles = [true, false].map(|upper| facing(pose, |joint| is_upper(joint) == upper));
    let turned = pose.iter().enumerate().map(|(joint, &place)| {
        let half = if is_upper(joint) {
            Half::Upper
        } else {
            Half::Lower
        };
        turned(place, -half.of(&angles))
    });
    (turned.collect(), angles)
}

/// Turns whole bodies by one angle, the one that brings the first to face +z.
pub(super) fn bodies_to_front(poses: &[Pose]) -> Vec<Pose> {
    let first = poses.first().map_or(0.0, |pose| facing(pose, |_| true));
    let front = |pose: &Pose| pose.iter().map(|&place| turned(place, -first)).collect();
    poses.iter().map(front).collect()
}

/// Where some joints of a pose face. The others are put where they tell no direction.
fn facing(pose: &[[f32; 3]], inside: impl Fn(usize) -> bool) -> f32 {
    let positions = Array3::from_shape_fn((1, pose.len(), 3), |(_, joint, axis)| {
        let place = pose.get(joint).filter(|_| inside(joint));
        place
            .and_then(|place| place.get(axis).copied())
            .unwrap_or(0.0)
    });
    headings(&positions).first().copied().unwrap_or(0.0)
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
        for (joint, x, y) in [
            (1, 0.1, 0.0),
            (2, -0.1, 0.0),
            (16, 0.2, 0.5),
            (17, -0.2, 0.5),
        ] {
            pose[joint] = [x, y, 0.0];
        }
        pose[23] = [0.0, 0.4, 0.3];
        pose
    }

    fn turn(pose: &Pose, angles: [f32; 2]) -> Pose {
        let upper = |joint| if joint >= 12 { angles[0] } else { angles[1] };
        let joints = pose.iter().enumerate();
        joints
            .map(|(joint, &place)| turned(place, upper(joint)))
            .collect()
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
        assert!(
            (angles[0] - 2.0).abs() < 1e-5 && (angles[1] + 1.0).abs() < 1e-5,
            "{angles:?}"
        );
        assert_close(&front, &body());
    }

    #[test]
    fn bodies_turn_with_the_first() {
        let poses = [turn(&body(), [1.0; 2]), turn(&body(), [1.5; 2])];
        let front = bodies_to_front(&poses);
        assert_close(&front[0], &body());
        assert_close(&front[1], &turn(&body(), [0.5; 2]));
    }
}
