//! BVH read back by a parser of this test.

use std::f32::consts::FRAC_PI_2;

use bailando_formats::{BvhUnit, GeneratedMotion, TargetSkeleton, to_bvh, to_bvh_for};
use bailando_motion::{Animation, FinishOptions, Positions, forward};
use bailando_testkit::motion::{dance_of, decoded_from, distances, skeleton};
use glam::{DQuat, DVec3, Quat, Vec3};

use crate::{finished, motion, recorded, short};

/// Largest step of an angle from frame to frame, degrees, where no joint turns faster.
const LARGEST_STEP: f64 = 30.0;

#[test]
fn bvh_read_back_gives_the_positions_of_forward_kinematics() {
    for (fps, unit, metre) in [
        (60, BvhUnit::Centimetre, 100.0),
        (24, BvhUnit::Centimetre, 100.0),
        (30, BvhUnit::Metre, 1.0),
    ] {
        let motion = motion(fps);
        let read = read_bvh(&to_bvh(&motion, unit).unwrap(), metre);
        assert!((read.frame_time - 1.0 / f64::from(fps)).abs() < 1e-8);
        let joints = &motion.skeleton.joints;
        assert_eq!(read.names.len(), joints.len());
        let positions = Positions::from_shape_fn(motion.positions.dim(), |(frame, joint, axis)| {
            read.positions[frame][read.index(&joints[joint])][axis] as f32
        });
        let expected = forward(&motion.skeleton, &motion.animation).unwrap();
        let (_, largest) = distances(&positions, &expected);
        assert!(largest < 1e-4, "{fps} fps, {unit:?}: {largest} m");
    }
}

#[test]
fn bvh_of_every_target_has_the_joints_at_the_same_places() {
    let motion = motion(30);
    let expected = forward(&motion.skeleton, &motion.animation).unwrap();
    for target in TargetSkeleton::ALL {
        let text = to_bvh_for(&motion, BvhUnit::Centimetre, target).unwrap();
        let read = read_bvh(&text, 100.0);
        // Unreal has a root above the 24 joints.
        let first = read.names.iter().position(|name| name != "root").unwrap();
        assert_eq!(read.names.len(), first + motion.skeleton.joints.len());
        let own = read_bvh(&to_bvh(&motion, BvhUnit::Centimetre).unwrap(), 100.0);
        let positions = Positions::from_shape_fn(motion.positions.dim(), |(frame, joint, axis)| {
            let place = first + own.index(&motion.skeleton.joints[joint]);
            read.positions[frame][place][axis] as f32
        });
        let (_, largest) = distances(&positions, &expected);
        assert!(largest < 1e-4, "{target:?}: {largest} m");
    }
}

#[test]
fn bvh_angles_of_a_turning_dancer_do_not_jump() {
    let mut motion = short(400);
    for (frame, pose) in motion.animation.rotations.iter_mut().enumerate() {
        pose[0] = Quat::from_rotation_y(0.05 * frame as f32);
        pose[4] = Quat::from_rotation_x(1.2 + 1.2 * (0.05 * frame as f32).sin());
    }
    let read = read_bvh(&to_bvh(&motion, BvhUnit::Centimetre).unwrap(), 100.0);
    let knee = 3 + 3 * read.index("l_knee");
    for rows in read.channels.windows(2) {
        for column in [3, 4, 5, knee, knee + 1, knee + 2] {
            let step = (rows[1][column] - rows[0][column]).abs();
            assert!(step < 8.0, "column {column}: {step} degrees");
        }
    }
    let turned = read.channels[399][3] - read.channels[0][3];
    let expected = (0.05_f64 * 399.0).to_degrees();
    assert!((turned - expected).abs() < 0.1, "{turned} degrees");
}

/// Some joints of recordings turn by more than 30 degrees in a frame: their angles must, too, but
/// not by much more.
#[test]
fn angles_of_recordings_begin_within_half_a_turn_and_jump_only_with_their_joints() {
    let dances = [false, true].map(|clean| FinishOptions { clean, ..FinishOptions::default() });
    for (name, motion) in dances.into_iter().flat_map(finished) {
        let frames = &motion.animation.rotations;
        for target in TargetSkeleton::ALL {
            let text = to_bvh_for(&motion, BvhUnit::Centimetre, target).unwrap();
            let read = read_bvh(&text, 100.0);
            let own = read_bvh(&to_bvh(&motion, BvhUnit::Centimetre).unwrap(), 100.0);
            let first = read.names.len() - own.names.len();
            for (place, joint) in own.names.iter().enumerate() {
                let column = 3 + 6 * first + 3 * place;
                let angles = |row: &Vec<f64>| row[column..column + 3].to_vec();
                assert!(angles(&read.channels[0]).iter().all(|angle| angle.abs() <= 180.0));
                let joint = motion.skeleton.joints.iter().position(|j| j == joint).unwrap();
                let turn = |pair: &[Vec<Quat>]| pair[0][joint].angle_between(pair[1][joint]);
                let turns = frames.windows(2).map(|pair| f64::from(turn(pair)).to_degrees());
                let most = LARGEST_STEP.max(1.25 * turns.fold(0.0, f64::max));
                let mut largest = 0.0_f64;
                for rows in read.channels.windows(2) {
                    let steps = angles(&rows[1]).into_iter().zip(angles(&rows[0]));
                    largest = steps.map(|(b, a)| (b - a).abs()).fold(largest, f64::max);
                }
                let bone = &read.names[first + place];
                assert!(largest <= most, "{name}, {bone}: {largest} of {most} degrees a frame");
            }
        }
    }
}

/// A bent left arm, held out, whose upper arm turns about itself through the pole of its angles.
#[test]
fn angles_of_an_arm_that_passes_its_pole_do_not_jump() {
    let skeleton = skeleton();
    let pose = |frame: usize| {
        let t = frame as f32 / 60.0 - 2.0;
        let mut pose = vec![Quat::IDENTITY; skeleton.joints.len()];
        pose[16] = Quat::from_rotation_z(0.05 + 0.03 * t)
            * Quat::from_rotation_x(FRAC_PI_2 + 1.2 * (2.0 * t).sin());
        pose[18] = Quat::from_rotation_y(-1.8);
        pose
    };
    let root = vec![Vec3::Y; 240];
    let animation = Animation { fps: 60, root, rotations: (0..240).map(pose).collect() };
    let decoded = decoded_from(&forward(&skeleton, &animation).unwrap());
    let motion = dance_of(&decoded, &FinishOptions::default());
    for target in TargetSkeleton::ALL {
        let text = to_bvh_for(&motion, BvhUnit::Centimetre, target).unwrap();
        let read = read_bvh(&text, 100.0);
        let steps = read.channels.windows(2).flat_map(|rows| {
            rows[1].iter().zip(&rows[0]).skip(6).map(|(b, a)| (b - a).abs()).collect::<Vec<_>>()
        });
        let largest = steps.fold(0.0, f64::max);
        assert!(largest < LARGEST_STEP, "{target:?}: {largest} degrees a frame");
    }
}

#[test]
fn a_continuation_starts_from_the_former_angles_but_for_full_turns() {
    for (name, motion) in recorded(60) {
        let half = motion.animation.root.len() / 2;
        let rows = |range: std::ops::Range<usize>| {
            let text = to_bvh(&part(&motion, range), BvhUnit::Centimetre).unwrap();
            read_bvh(&text, 100.0).channels
        };
        let before = rows(0..half + 1);
        let after = rows(half..half + 2);
        for (column, (a, b)) in before[half].iter().zip(&after[0]).enumerate().skip(3) {
            let turns = ((a - b) / 360.0).round();
            let apart = (a - b - 360.0 * turns).abs();
            assert!(apart < 1e-3, "{name}, column {column}: {a} then {b} degrees");
        }
    }
}

/// Some frames of a motion.
fn part(motion: &GeneratedMotion, range: std::ops::Range<usize>) -> GeneratedMotion {
    let mut part = motion.clone();
    part.animation.root = motion.animation.root[range.clone()].to_vec();
    part.animation.rotations = motion.animation.rotations[range.clone()].to_vec();
    part.positions = motion.positions.slice_axis(ndarray::Axis(0), range.into()).to_owned();
    part
}

/// A BVH file as this test understands it: joints in the order of the hierarchy.
struct ReadBvh {
    names: Vec<String>,
    frame_time: f64,
    channels: Vec<Vec<f64>>,
    /// World positions in metres, `[frame][joint]`.
    positions: Vec<Vec<DVec3>>,
}

impl ReadBvh {
    fn index(&self, joint: &str) -> usize {
        self.names.iter().position(|name| name == joint).unwrap()
    }
}

#[derive(Default)]
struct Hierarchy {
    names: Vec<String>,
    /// Channels of each joint: axes of its positions, if it has any, then of its rotations.
    channels: Vec<[Vec<usize>; 2]>,
    parents: Vec<Option<usize>>,
    offsets: Vec<DVec3>,
}

fn read_hierarchy(text: &str, metre: f64) -> Hierarchy {
    let mut read = Hierarchy::default();
    let mut open: Vec<Option<usize>> = Vec::new();
    let mut next = None;
    for line in text.lines().skip(1) {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[0] {
            "ROOT" | "JOINT" => {
                next = Some(read.names.len());
                read.parents.push(open.last().copied().flatten());
                read.names.push(words[1].to_owned());
            }
            "End" => next = None,
            "{" => open.push(next),
            "}" => _ = open.pop().unwrap(),
            "OFFSET" => {
                let numbers: Vec<f64> = words[1..].iter().map(|w| w.parse().unwrap()).collect();
                let offset = DVec3::from_slice(&numbers);
                match open.last().unwrap() {
                    Some(_) => read.offsets.push(offset),
                    None => assert!(offset.length() > 0.01 * metre, "End Sites can be seen"),
                }
            }
            "CHANNELS" => {
                let axes = |kind: &str| {
                    let axes = words.iter().filter_map(|word| word.strip_suffix(kind));
                    axes.map(|axis| "XYZ".find(axis).unwrap()).collect::<Vec<_>>()
                };
                let (moves, turns) = (axes("position"), axes("rotation"));
                assert!(moves.is_empty() || words[2].ends_with("position"), "positions come first");
                assert_eq!(words[1], (moves.len() + turns.len()).to_string());
                read.channels.push([moves, turns]);
            }
            other => panic!("{other:?} in the hierarchy"),
        }
    }
    assert!(open.is_empty());
    read
}

fn read_bvh(text: &str, metre: f64) -> ReadBvh {
    let (hierarchy, motion) = text.split_once("MOTION\n").unwrap();
    let Hierarchy { names, channels: kinds, parents, offsets } = read_hierarchy(hierarchy, metre);
    let mut lines = motion.lines();
    let frames = lines.next().unwrap().strip_prefix("Frames: ").unwrap();
    let time = lines.next().unwrap().strip_prefix("Frame Time: ").unwrap();
    let numbers = |line: &str| line.split(' ').map(|w| w.parse().unwrap()).collect();
    let channels: Vec<Vec<f64>> = lines.map(numbers).collect();
    assert_eq!(frames.parse::<usize>().unwrap(), channels.len());
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let pose = |row: &Vec<f64>| {
        let mut values = row.iter().copied();
        let mut world: Vec<(DVec3, DQuat)> = Vec::new();
        for joint in 0..names.len() {
            let [moves, turns] = &kinds[joint];
            let shift: DVec3 = moves.iter().map(|&k| axes[k] * values.next().unwrap()).sum();
            let turn =
                |&k: &usize| DQuat::from_axis_angle(axes[k], values.next().unwrap().to_radians());
            let local = turns.iter().map(turn).fold(DQuat::IDENTITY, |all, turn| all * turn);
            let place = offsets[joint] + shift;
            world.push(match parents[joint] {
                None => (place, local),
                Some(parent) => {
                    let (position, rotation) = world[parent];
                    (position + rotation * place, rotation * local)
                }
            });
        }
        assert_eq!(values.next(), None);
        world.into_iter().map(|(p, _)| p / metre).collect()
    };
    ReadBvh {
        positions: channels.iter().map(pose).collect(),
        frame_time: time.parse().unwrap(),
        names,
        channels,
    }
}
