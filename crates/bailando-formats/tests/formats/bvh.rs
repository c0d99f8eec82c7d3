//! BVH read back by a parser of this test.

use bailando_formats::{BvhUnit, to_bvh};
use bailando_motion::{Positions, forward};
use bailando_testkit::motion::distances;
use glam::{DMat3, DVec3, Quat};

use crate::{motion, short};

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
            "CHANNELS" => assert!(line.ends_with("Yrotation Xrotation Zrotation")),
            other => panic!("{other:?} in the hierarchy"),
        }
    }
    assert!(open.is_empty());
    read
}

fn read_bvh(text: &str, metre: f64) -> ReadBvh {
    let (hierarchy, motion) = text.split_once("MOTION\n").unwrap();
    let Hierarchy { names, parents, offsets } = read_hierarchy(hierarchy, metre);
    let mut lines = motion.lines();
    let frames = lines.next().unwrap().strip_prefix("Frames: ").unwrap();
    let time = lines.next().unwrap().strip_prefix("Frame Time: ").unwrap();
    let numbers = |line: &str| line.split(' ').map(|w| w.parse().unwrap()).collect();
    let channels: Vec<Vec<f64>> = lines.map(numbers).collect();
    assert_eq!(frames.parse::<usize>().unwrap(), channels.len());
    let pose = |row: &Vec<f64>| {
        let mut world: Vec<(DVec3, DMat3)> = Vec::new();
        for joint in 0..names.len() {
            let angle = |k: usize| row[3 + 3 * joint + k].to_radians();
            let local = DMat3::from_rotation_y(angle(0))
                * DMat3::from_rotation_x(angle(1))
                * DMat3::from_rotation_z(angle(2));
            world.push(match parents[joint] {
                None => (offsets[0] + DVec3::from_slice(&row[..3]), local),
                Some(parent) => {
                    let (position, rotation) = world[parent];
                    (position + rotation * offsets[joint], rotation * local)
                }
            });
        }
        world.into_iter().map(|(p, _)| p / metre).collect()
    };
    ReadBvh {
        positions: channels.iter().map(pose).collect(),
        frame_time: time.parse().unwrap(),
        names,
        channels,
    }
}
