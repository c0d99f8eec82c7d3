//! Rotations to positions and back.

use bailando_motion::{
    Animation, InverseKinematics, MotionError, Positions, STANDING_HEIGHT, Skeleton,
    floor_correction, forward, lower_foot_heights,
};
use bailando_testkit::motion::{distances, recordings, skeleton};
use glam::{Quat, Vec3};
use proptest::prelude::*;

use crate::{assert_continuous_unit_quaternions, assert_near, posed, still, swinging};

fn solved_on(skeleton: &Skeleton, positions: &Positions) -> Result<Animation, MotionError> {
    InverseKinematics::new(skeleton)?.solve(positions, 60)
}

fn solved(positions: &Positions) -> Animation {
    let solved = solved_on(&skeleton(), positions).unwrap();
    assert_continuous_unit_quaternions(&solved);
    solved
}

#[test]
fn rest_pose_heads_for_z_with_left_at_positive_x() {
    let rest = posed(&still(1, Quat::IDENTITY));
    let skeleton = skeleton();
    let of = |name: &str, axis| {
        let joint = skeleton.joints.iter().position(|j| j == name).unwrap();
        rest[[0, joint, axis]]
    };
    for pair in ["hip", "shoulder", "hand", "foot"] {
        assert!(of(&format!("l_{pair}"), 0) > 0.03, "{pair}");
        assert!(of(&format!("r_{pair}"), 0) < -0.03, "{pair}");
    }
    assert!(of("l_foot", 2) > of("l_ankle", 2) + 0.1, "toes point to +z");
    assert!(of("head", 1) > 0.5 && of("l_foot", 1) < -0.9);
}

#[test]
fn a_quarter_turn_takes_the_left_hand_to_the_back() {
    // Right-handed, y up: turning by +90 degrees about y takes +x to -z.
    let turned = posed(&still(1, Quat::from_rotation_y(std::f32::consts::FRAC_PI_2)));
    assert!(turned[[0, 22, 2]] < -0.7 && turned[[0, 22, 0]].abs() < 0.2);
    assert!(turned[[0, 10, 0]] > 0.05, "and the toes to +x");
}

#[test]
fn inverse_kinematics_meets_positions_of_the_skeleton() {
    let positions = posed(&swinging(300, 60));
    let solved = solved(&positions);
    assert_near(&positions, &posed(&solved), 1e-5);
    for pose in &solved.rotations {
        let leaves = [10, 11, 15, 22, 23].map(|leaf| pose[leaf]);
        assert_eq!(leaves, [Quat::IDENTITY; 5]);
    }
}

#[test]
fn joints_with_one_child_swing_without_twist() {
    let skeleton = skeleton();
    let solved = solved(&posed(&swinging(120, 60)));
    // Knees, elbows, shoulders: the axis of the smallest rotation is at right angles to the bone.
    for (joint, child) in [(4, 7), (5, 8), (16, 18), (18, 20), (1, 4)] {
        let bone = Vec3::from_array(skeleton.offsets[child]).normalize();
        for pose in &solved.rotations {
            assert!(pose[joint].xyz().dot(bone).abs() < 1e-4);
        }
    }
}

#[test]
fn bones_without_length_keep_the_rotation_they_had() {
    let mut positions = posed(&swinging(3, 60));
    // In the middle frame the whole body falls together in one point.
    positions.index_axis_mut(ndarray::Axis(0), 1).fill(0.25);
    let solved = solved(&positions);
    for (before, during) in solved.rotations[0].iter().zip(&solved.rotations[1]) {
        assert!(before.dot(*during) > 1.0 - 1e-5);
    }
    let mut flat = skeleton();
    flat.offsets.fill([0.0; 3]);
    let solved = solved_on(&flat, &positions).unwrap();
    let mut all = solved.rotations.iter().flatten();
    assert!(all.all(|&q| q == Quat::IDENTITY));
}

#[test]
fn motions_that_do_not_fit_are_refused() {
    let joints = solved_on(&skeleton(), &Positions::zeros((2, 23, 3)));
    assert!(matches!(joints, Err(MotionError::Shape { .. })));
    let mut poisoned = Positions::zeros((5, 24, 3));
    poisoned[[3, 7, 1]] = f32::INFINITY;
    let (frame, joint) = (3, 7);
    let poisoned = solved_on(&skeleton(), &poisoned);
    assert_eq!(poisoned, Err(MotionError::NotFinite { frame, joint }));
    let mut short = swinging(4, 60);
    short.rotations[2].pop();
    let short = forward(&skeleton(), &short);
    assert!(matches!(short, Err(MotionError::Shape { .. })));
    let mut loops = skeleton();
    loops.parents[3] = 9;
    let loops = solved_on(&loops, &Positions::zeros((1, 24, 3)));
    assert!(matches!(loops, Err(MotionError::Skeleton(_))));
}

#[test]
fn feet_are_found_by_name_and_else_by_height() {
    let mut skeleton = skeleton();
    assert_eq!(skeleton.foot_joints(), [10, 11]);
    skeleton.joints.fill("unnamed".into());
    assert_eq!(skeleton.foot_joints(), [10, 11]);
}

#[test]
fn a_dancer_who_only_squats_is_left_alone() {
    // Feet stay where they are while the pelvis goes down and up.
    let mut positions = posed(&still(900, Quat::IDENTITY));
    let lowest = positions[[0, 11, 1]].min(positions[[0, 10, 1]]);
    for (i, mut pose) in positions.outer_iter_mut().enumerate() {
        let squat = 0.35 * (i as f32 * 0.01).sin().powi(2);
        for mut joint in pose.outer_iter_mut() {
            joint[1] += STANDING_HEIGHT - lowest;
        }
        for joint in [0, 1, 2, 3, 6, 9, 12, 15] {
            pose[[joint, 1]] -= squat;
        }
    }
    let lift = floor_correction(&lower_foot_heights(&positions, &skeleton()), 60);
    assert!(lift.iter().all(|l| l.abs() < 1e-3));
}

#[test]
fn recordings_are_met_by_their_skeleton() {
    let Some(folder) = bailando_testkit::shared("data/salsa") else {
        return;
    };
    let (mut sum, mut frames, mut furthest) = (0.0, 0.0, 0.0_f64);
    for (path, positions) in recordings(&folder) {
        let (mean, largest) = distances(&positions, &posed(&solved(&positions)));
        assert!(largest < 5e-4, "{}: {largest} m", path.display());
        sum += mean * positions.dim().0 as f64;
        frames += positions.dim().0 as f64;
        furthest = furthest.max(largest);
    }
    let mean = sum / frames;
    println!("recordings: {frames} frames, mean {mean:.3e} m, largest {furthest:.3e} m");
}

proptest! {
    #[test]
    fn any_finite_positions_give_unit_rotations(
        values in prop::collection::vec(-1.0..1.0_f32, 3 * 72),
    ) {
        solved(&Positions::from_shape_vec((3, 24, 3), values).unwrap());
    }
}
