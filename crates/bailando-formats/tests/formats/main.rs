//! Dances as files: what is in them, and whether it can be read back.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test says what is wrong by failing"
)]

mod bvh_readers;

use bailando_formats::{BvhUnit, Dance, Encoding, JsonOptions, OutputFormat, to_bvh, to_json};
use bailando_motion::{FinishOptions, Positions, forward};
use bailando_testkit::motion::{dance_of, distances, fixture};
use base64::{Engine, engine::general_purpose::STANDARD};
use glam::{DMat3, DVec3};
use serde_json::Value;

fn dance(fps: u32) -> Dance {
    let options = FinishOptions {
        fps,
        ..FinishOptions::default()
    };
    dance_of(&fixture("decode_raw.npy"), &options)
}

fn short(frames: usize) -> Dance {
    let decoded = fixture("decode_raw.npy");
    let rows = decoded
        .outer_iter()
        .take(frames)
        .flatten()
        .copied()
        .collect();
    let decoded = ndarray::Array2::from_shape_vec((frames, 72), rows).unwrap();
    dance_of(&decoded, &FinishOptions::default())
}

fn json(dance: &Dance, options: JsonOptions) -> Value {
    serde_json::from_slice(&to_json(dance, &options).unwrap()).unwrap()
}

const WITH_ROTATIONS: JsonOptions = JsonOptions {
    rotations: true,
    encoding: Encoding::Json,
};

#[test]
fn json_has_the_documented_shape() {
    let mut value = json(&short(2), WITH_ROTATIONS);
    for array in ["positions", "rotations"] {
        for frame in value[array].as_array_mut().unwrap() {
            assert_eq!(frame.as_array().unwrap().len(), 24);
            frame.as_array_mut().unwrap().truncate(1);
        }
    }
    // What the numbers are is the next test's business.
    for array in ["positions", "rotations", "root"] {
        without_digits(&mut value[array]);
    }
    for list in ["joints", "parents", "offsets"] {
        assert_eq!(value["skeleton"][list].as_array().unwrap().len(), 24);
        value["skeleton"][list].as_array_mut().unwrap().truncate(2);
    }
    insta::assert_json_snapshot!(value);
}

/// Two decimals of every number: the last ones may differ between processors.
fn without_digits(value: &mut Value) {
    match value {
        Value::Array(values) => values.iter_mut().for_each(without_digits),
        _ => *value = format!("{:.2}", value.as_f64().unwrap()).into(),
    }
}

#[test]
fn rotations_and_music_are_absent_unless_there() {
    let mut dance = short(1);
    dance.music = None;
    let value = json(&dance, JsonOptions::default());
    for key in ["rotations", "root", "music"] {
        assert!(value.get(key).is_none(), "{key}");
    }
}

#[test]
fn json_numbers_are_the_dances_to_a_micrometre() {
    let dance = dance(60);
    let value = json(&dance, WITH_ROTATIONS);
    let close = |value: &Value, expected: f32| {
        let error = (value.as_f64().unwrap() - f64::from(expected)).abs();
        assert!(error <= 0.501e-6, "{error}");
    };
    for ((frame, joint, axis), &expected) in dance.positions.indexed_iter() {
        close(&value["positions"][frame][joint][axis], expected);
    }
    for (frame, pose) in dance.animation.rotations.iter().enumerate() {
        for (joint, q) in pose.iter().enumerate() {
            for (axis, expected) in q.to_array().into_iter().enumerate() {
                close(&value["rotations"][frame][joint][axis], expected);
            }
        }
    }
    for (frame, root) in dance.animation.root.iter().enumerate() {
        for axis in 0..3 {
            close(&value["root"][frame][axis], root[axis]);
        }
    }
}

#[test]
fn base64_holds_the_same_numbers_exactly() {
    let dance = dance(30);
    let options = JsonOptions {
        rotations: true,
        encoding: Encoding::Base64,
    };
    let value = json(&dance, options);
    assert_eq!(value["encoding"], "base64");
    assert_eq!(value["positions_source"], "forward_kinematics");
    let floats = |key: &str| -> Vec<f32> {
        let bytes = STANDARD.decode(value[key].as_str().unwrap()).unwrap();
        let (words, rest) = bytes.as_chunks::<4>();
        assert!(rest.is_empty());
        words.iter().map(|b| f32::from_le_bytes(*b)).collect()
    };
    assert_eq!(
        floats("positions"),
        dance.positions.iter().copied().collect::<Vec<_>>()
    );
    let rotations = dance.animation.rotations.iter().flatten();
    assert_eq!(
        floats("rotations"),
        rotations.flat_map(|q| q.to_array()).collect::<Vec<_>>()
    );
    let root = dance.animation.root.iter();
    assert_eq!(
        floats("root"),
        root.flat_map(|p| p.to_array()).collect::<Vec<_>>()
    );
}

#[test]
fn dances_that_contradict_themselves_are_refused() {
    type Spoil = fn(&mut Dance);
    let spoils: [(&str, Spoil); 5] = [
        ("not finite", |d| d.positions[[1, 2, 0]] = f32::NAN),
        ("2 roots", |d| {
            d.animation.root.pop();
        }),
        ("in frame 1", |d| {
            d.animation.rotations[1].pop();
        }),
        ("unit length", |d| d.animation.rotations[0][3] *= 0.5),
        ("skeleton", |d| d.skeleton.parents[4] = 9),
    ];
    for (expected, spoil) in spoils {
        let mut dance = short(3);
        spoil(&mut dance);
        for format in OutputFormat::ALL {
            let error = format
                .write(&dance, &JsonOptions::default(), BvhUnit::default())
                .unwrap_err()
                .to_string();
            assert!(
                error.contains(expected),
                "{error:?} should say {expected:?}"
            );
        }
    }
}

#[test]
fn bvh_header_is_as_programs_expect_it() {
    let text = to_bvh(&short(2), BvhUnit::Centimetre).unwrap();
    let (header, motion) = text.split_at(text.find("Frame Time").unwrap());
    insta::assert_snapshot!(header.replace('\t', "  "));
    let lines: Vec<&str> = motion.lines().collect();
    assert_eq!(lines[0], "Frame Time: 0.01666667");
    assert_eq!(lines.len(), 3);
    assert!(
        lines[1..]
            .iter()
            .all(|line| line.split(' ').count() == 3 + 3 * 24)
    );
}

#[test]
fn bvh_read_back_gives_the_positions_of_forward_kinematics() {
    for (fps, unit, metre) in [
        (60, BvhUnit::Centimetre, 100.0),
        (24, BvhUnit::Centimetre, 100.0),
        (30, BvhUnit::Metre, 1.0),
    ] {
        let dance = dance(fps);
        let read = read_bvh(&to_bvh(&dance, unit).unwrap(), metre);
        assert!((read.frame_time - 1.0 / f64::from(fps)).abs() < 1e-8);
        let mut sorted = read.names.clone();
        sorted.sort();
        let mut expected = dance.skeleton.joints.clone();
        expected.sort();
        assert_eq!(sorted, expected);
        let places = Positions::from_shape_fn(dance.positions.dim(), |(frame, joint, axis)| {
            let name = &dance.skeleton.joints[joint];
            let index = read.names.iter().position(|n| n == name).unwrap();
            read.places[frame][index][axis] as f32
        });
        let (_, largest) = distances(
            &places,
            &forward(&dance.skeleton, &dance.animation).unwrap(),
        );
        assert!(largest < 1e-4, "{fps} fps, {unit:?}: {largest} m");
    }
}

#[test]
fn bvh_angles_of_a_turning_dancer_do_not_jump() {
    let mut dance = short(400);
    for (frame, pose) in dance.animation.rotations.iter_mut().enumerate() {
        pose[0] = glam::Quat::from_rotation_y(0.05 * frame as f32);
        pose[4] = glam::Quat::from_rotation_x(1.2 + 1.2 * (0.05 * frame as f32).sin());
    }
    let text = to_bvh(&dance, BvhUnit::Centimetre).unwrap();
    let read = read_bvh(&text, 100.0);
    let knee = read.names.iter().position(|n| n == "l_knee").unwrap();
    for rows in read.channels.windows(2) {
        for column in [3, 4, 5, 3 + 3 * knee, 4 + 3 * knee, 5 + 3 * knee] {
            assert!(
                (rows[1][column] - rows[0][column]).abs() < 8.0,
                "column {column}"
            );
        }
    }
    let turned = read.channels[399][3] - read.channels[0][3];
    assert!(
        (turned - (0.05_f64 * 399.0).to_degrees()).abs() < 0.1,
        "{turned} degrees"
    );
}

/// A BVH file as this test understands it: joints in the order of the hierarchy.
struct ReadBvh {
    names: Vec<String>,
    frame_time: f64,
    channels: Vec<Vec<f64>>,
    /// World positions in metres, `[frame][joint]`.
    places: Vec<Vec<DVec3>>,
}

fn read_bvh(text: &str, metre: f64) -> ReadBvh {
    let (hierarchy, motion) = text.split_once("MOTION\n").unwrap();
    let (mut names, mut parents, mut offsets) = (Vec::new(), Vec::new(), Vec::new());
    let mut open: Vec<Option<usize>> = Vec::new();
    let mut next = None;
    for line in hierarchy.lines().skip(1) {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[0] {
            "ROOT" | "JOINT" => {
                parents.push(open.last().copied().flatten());
                names.push(words[1].to_owned());
                next = Some(names.len() - 1);
            }
            "End" => next = None,
            "{" => open.push(next),
            "}" => {
                open.pop().unwrap();
            }
            "OFFSET" => {
                let numbers: Vec<f64> = words[1..].iter().map(|w| w.parse().unwrap()).collect();
                let offset = DVec3::from_slice(&numbers);
                match open.last().unwrap() {
                    Some(_) => offsets.push(offset),
                    None => assert!(offset.length() > 0.01 * metre, "End Sites can be seen"),
                }
            }
            "CHANNELS" => assert!(line.ends_with("Yrotation Xrotation Zrotation")),
            other => panic!("{other:?} in the hierarchy"),
        }
    }
    assert!(open.is_empty());
    let mut lines = motion.lines();
    let frames = lines.next().unwrap().strip_prefix("Frames: ").unwrap();
    let time = lines.next().unwrap().strip_prefix("Frame Time: ").unwrap();
    let numbers = |line: &str| line.split(' ').map(|w| w.parse().unwrap()).collect();
    let channels: Vec<Vec<f64>> = lines.map(numbers).collect();
    assert_eq!(frames.parse::<usize>().unwrap(), channels.len());
    let pose = |row: &Vec<f64>| {
        let mut places: Vec<DVec3> = Vec::new();
        let mut turns: Vec<DMat3> = Vec::new();
        for joint in 0..names.len() {
            let angle = |k: usize| row[3 + 3 * joint + k].to_radians();
            let local = DMat3::from_rotation_y(angle(0))
                * DMat3::from_rotation_x(angle(1))
                * DMat3::from_rotation_z(angle(2));
            let (place, turn) = match parents[joint] {
                None => (offsets[0] + DVec3::from_slice(&row[..3]), local),
                Some(p) => (places[p] + turns[p] * offsets[joint], turns[p] * local),
            };
            places.push(place);
            turns.push(turn);
        }
        places.into_iter().map(|p| p / metre).collect()
    };
    let places = channels.iter().map(pose).collect();
    ReadBvh {
        names,
        frame_time: time.parse().unwrap(),
        channels,
        places,
    }
}
