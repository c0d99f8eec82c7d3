//! The motion chain as a whole: rotations to positions and back, the floor, a finished motion.

use glam::{Quat, Vec3};
use ndarray::Array2;
use proptest::prelude::*;

use super::*;

/// The skeleton of the motion that models are trained on.
fn skeleton() -> Skeleton {
    serde_json::from_str(include_str!("../../../tests/fixtures/motion/skeleton.json")).unwrap()
}

fn furthest(a: &Positions, b: &Positions) -> f32 {
    assert_eq!(a.dim(), b.dim());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

/// A lively motion: every joint swings about its own axis with its own period.
fn swinging(frames: usize, fps: u32) -> Animation {
    let joints = skeleton().joints.len();
    let angle = |joint: usize, frame: usize| {
        let seconds = frame as f32 / fps as f32;
        0.9 * (seconds * (2.0 + joint as f32 * 0.3) + joint as f32).sin()
    };
    let axis = |joint: usize| {
        let j = joint as f32;
        Vec3::new((j * 1.7).sin(), (j * 2.3).cos(), (j * 0.9).sin() + 0.2).normalize()
    };
    let pose = |frame| {
        (0..joints)
            .map(|joint| Quat::from_axis_angle(axis(joint), angle(joint, frame)))
            .collect()
    };
    Animation {
        fps,
        root: (0..frames)
            .map(|f| Vec3::new(0.01 * f as f32, 0.9, -0.3))
            .collect(),
        rotations: (0..frames).map(pose).collect(),
    }
}

fn assert_continuous_unit_quaternions(animation: &Animation) {
    for pose in &animation.rotations {
        assert!(pose.iter().all(|q| (q.length() - 1.0).abs() < 1e-5));
    }
    for pair in animation.rotations.windows(2) {
        assert!(pair[0].iter().zip(&pair[1]).all(|(a, b)| a.dot(*b) >= 0.0));
    }
}

#[test]
fn rest_pose_faces_front_with_left_at_positive_x() {
    let skeleton = skeleton();
    let still = Animation {
        fps: 60,
        root: vec![Vec3::ZERO],
        rotations: vec![vec![Quat::IDENTITY; 24]],
    };
    let rest = forward(&skeleton, &still).unwrap();
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
    let turned = Animation {
        fps: 60,
        root: vec![Vec3::ZERO],
        rotations: vec![
            std::iter::once(Quat::from_rotation_y(std::f32::consts::FRAC_PI_2))
                .chain(std::iter::repeat_n(Quat::IDENTITY, 23))
                .collect(),
        ],
    };
    let positions = forward(&skeleton(), &turned).unwrap();
    assert!(positions[[0, 22, 2]] < -0.7 && positions[[0, 22, 0]].abs() < 0.2);
    assert!(positions[[0, 10, 0]] > 0.05, "and the toes to +x");
}

#[test]
fn inverse_kinematics_meets_positions_of_the_skeleton() {
    let positions = forward(&skeleton(), &swinging(300, 60)).unwrap();
    let solved = InverseKinematics::new(&skeleton())
        .unwrap()
        .solve(&positions, 60)
        .unwrap();
    assert_continuous_unit_quaternions(&solved);
    let again = forward(&skeleton(), &solved).unwrap();
    assert!(
        furthest(&positions, &again) < 1e-5,
        "{}",
        furthest(&positions, &again)
    );
    for leaf in [10, 11, 15, 22, 23] {
        assert!(
            solved
                .rotations
                .iter()
                .all(|pose| pose[leaf] == Quat::IDENTITY)
        );
    }
}

#[test]
fn joints_with_one_child_swing_without_twist() {
    let skeleton = skeleton();
    let positions = forward(&skeleton, &swinging(120, 60)).unwrap();
    let solver = InverseKinematics::new(&skeleton).unwrap();
    let solved = solver.solve(&positions, 60).unwrap();
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
    let skeleton = skeleton();
    let mut positions = forward(&skeleton, &swinging(3, 60)).unwrap();
    // In the middle frame the whole body falls together in one point.
    positions.index_axis_mut(ndarray::Axis(0), 1).fill(0.25);
    let solver = InverseKinematics::new(&skeleton).unwrap();
    let solved = solver.solve(&positions, 60).unwrap();
    assert_continuous_unit_quaternions(&solved);
    for (before, during) in solved.rotations[0].iter().zip(&solved.rotations[1]) {
        assert!(before.dot(*during) > 1.0 - 1e-5);
    }
    let mut flat = skeleton;
    flat.offsets.fill([0.0; 3]);
    let solved = InverseKinematics::new(&flat)
        .unwrap()
        .solve(&positions, 60)
        .unwrap();
    assert!(
        solved
            .rotations
            .iter()
            .flatten()
            .all(|&q| q == Quat::IDENTITY)
    );
}

#[test]
fn motions_that_do_not_fit_are_refused() {
    let solver = InverseKinematics::new(&skeleton()).unwrap();
    assert!(matches!(
        solver.solve(&Positions::zeros((2, 23, 3)), 60),
        Err(MotionError::Shape { .. })
    ));
    let mut poisoned = Positions::zeros((5, 24, 3));
    poisoned[[3, 7, 1]] = f32::INFINITY;
    assert_eq!(
        solver.solve(&poisoned, 60),
        Err(MotionError::NotFinite { frame: 3, joint: 7 })
    );
    let mut short = swinging(4, 60);
    short.rotations[2].pop();
    assert!(matches!(
        forward(&skeleton(), &short),
        Err(MotionError::Shape { .. })
    ));
    let mut loops = skeleton();
    loops.parents[3] = 9;
    assert!(matches!(
        InverseKinematics::new(&loops),
        Err(MotionError::Skeleton(_))
    ));
}

#[test]
fn feet_are_found_by_name_and_else_by_height() {
    assert_eq!(skeleton().foot_joints(), [10, 11]);
    let mut unnamed = skeleton();
    for (i, name) in unnamed.joints.iter_mut().enumerate() {
        *name = format!("bone{i}");
    }
    assert_eq!(unnamed.foot_joints(), [10, 11]);
}

proptest! {
    #[test]
    fn any_finite_positions_give_unit_rotations(
        values in prop::collection::vec(-1.0..1.0_f32, 3 * 72),
    ) {
        let positions = Positions::from_shape_vec((3, 24, 3), values).unwrap();
        let solver = InverseKinematics::new(&skeleton()).unwrap();
        let solved = solver.solve(&positions, 60).unwrap();
        assert_continuous_unit_quaternions(&solved);
    }
}

#[test]
fn a_dancer_who_only_squats_is_left_alone() {
    let skeleton = skeleton();
    // Feet stay where they are while the pelvis goes down and up.
    let still = Animation {
        fps: 60,
        root: vec![Vec3::ZERO; 900],
        rotations: vec![vec![Quat::IDENTITY; 24]; 900],
    };
    let mut positions = forward(&skeleton, &still).unwrap();
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
    let heights = lower_foot_heights(&positions, &skeleton);
    let lift = floor_correction(&heights, 60);
    assert!(lift.iter().all(|l| l.abs() < 1e-3));
}

mod finished {
    use super::*;

    /// What a decoder would say about `animation`, with `drift` metres a second added to its root.
    fn decoded(animation: &Animation, drift: f32) -> Array2<f32> {
        let positions = forward(&skeleton(), animation).unwrap();
        let frames = animation.root.len();
        Array2::from_shape_fn((frames, 72), |(frame, column)| {
            let (joint, axis) = (column / 3, column % 3);
            let root = |frame: usize| animation.root[frame.min(frames - 1)][axis];
            if joint == 0 {
                let slide = if axis == 1 { drift / 60.0 } else { 0.0 };
                root(frame + 1) - root(frame) + slide
            } else {
                positions[[frame, joint, axis]] - root(frame)
            }
        })
    }

    #[test]
    fn at_the_decoders_rate_the_decoders_poses_come_back() {
        let decoded = decoded(&swinging(600, 60), 0.05);
        let done = finish(decoded.view(), &skeleton(), &FinishOptions::default()).unwrap();
        assert_eq!(done.source, PositionsSource::Decoder);
        assert_eq!(done.positions.dim(), (600, 24, 3));
        for (frame, pose) in done.positions.outer_iter().enumerate() {
            for joint in 1..24 {
                for axis in 0..3 {
                    let relative = pose[[joint, axis]] - pose[[0, axis]];
                    assert!((relative - decoded[[frame, 3 * joint + axis]]).abs() < 1e-5);
                }
            }
            let root = done.animation.root[frame];
            assert_eq!([root.x, root.z], [pose[[0, 0]], pose[[0, 2]]]);
        }
        let again = forward(&skeleton(), &done.animation).unwrap();
        assert!(furthest(&done.positions, &again) < 1e-4);
    }

    #[test]
    fn at_other_rates_positions_are_those_of_the_rotations() {
        let decoded = decoded(&swinging(601, 60), 0.0);
        for (fps, frames) in [(20, 201), (24, 241), (30, 301)] {
            let options = FinishOptions {
                fps,
                ..FinishOptions::default()
            };
            let done = finish(decoded.view(), &skeleton(), &options).unwrap();
            assert_eq!(done.source, PositionsSource::ForwardKinematics);
            assert_eq!(done.positions.dim(), (frames, 24, 3));
            let again = forward(&skeleton(), &done.animation).unwrap();
            assert!(furthest(&done.positions, &again) < 1e-5);
        }
        let options = FinishOptions {
            fps: 25,
            ..FinishOptions::default()
        };
        assert_eq!(
            finish(decoded.view(), &skeleton(), &options),
            Err(MotionError::FrameRate { got: 25 })
        );
    }

    #[test]
    fn without_root_motion_the_dancer_stays_in_place_at_the_same_height() {
        let decoded = decoded(&swinging(300, 60), 0.0);
        let travels = finish(decoded.view(), &skeleton(), &FinishOptions::default()).unwrap();
        let options = FinishOptions {
            root_motion: false,
            ..FinishOptions::default()
        };
        let stays = finish(decoded.view(), &skeleton(), &options).unwrap();
        for (a, b) in stays.animation.root.iter().zip(&travels.animation.root) {
            assert_eq!((a.x, a.z), (0.0, 0.0));
            assert_eq!(a.y, b.y);
        }
        assert!(travels.animation.root[299].x > 2.0);
        assert_eq!(stays.animation.rotations, travels.animation.rotations);
        let again = forward(&skeleton(), &stays.animation).unwrap();
        assert!(furthest(&stays.positions, &again) < 1e-4);
    }

    #[test]
    fn an_empty_or_single_frame_is_no_special_case() {
        for frames in [0, 1] {
            let decoded = Array2::<f32>::zeros((frames, 72));
            for fps in FRAME_RATES {
                let options = FinishOptions {
                    fps,
                    ..FinishOptions::default()
                };
                let done = finish(decoded.view(), &skeleton(), &options).unwrap();
                assert_eq!(done.positions.dim(), (frames, 24, 3));
            }
        }
    }

    #[test]
    fn another_skeleton_is_refused() {
        let decoded = Array2::<f32>::zeros((4, 69));
        assert!(matches!(
            finish(decoded.view(), &skeleton(), &FinishOptions::default()),
            Err(MotionError::Shape { .. })
        ));
    }
}
