//! BVH: hierarchy and channels to local rotations, and joint positions by forward kinematics.
//!
//! Joints are found by their names, so that files of other programs with the same skeleton work in
//! any order of joints and channels. The root's place is that of its position channels, as its
//! OFFSET is zero in our files.

use std::str::SplitWhitespace;

use glam::{DQuat, DVec3};
use ndarray::Array3;

use crate::body::{
    JOINT_NAMES, JOINTS, SkeletalMotion, check_rate,
    joint::{L_ANKLE, L_KNEE},
};

/// A longer leg is measured in centimetres, not in metres.
const LONGEST_LEG: f64 = 5.0;
const METRES_PER_CENTIMETRE: f64 = 0.01;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Channel {
    Position(usize),
    Rotation(DVec3),
}

#[derive(Debug)]
struct Joint {
    name: String,
    parent: Option<usize>,
    offset: DVec3,
    channels: Vec<Channel>,
}

/// Returns positions `[frames, 24, 3]` in metres, SMPL order, and the rotations behind them.
pub(super) fn read(text: &str) -> Result<(Array3<f32>, SkeletalMotion), String> {
    let mut words = text.split_whitespace();
    let joints = hierarchy(&mut words)?;
    let order = smpl_order(&joints)?;
    let scale = metres(&joints, &order);
    let frames: usize = labelled(&mut words, &["Frames:"])?;
    let frame_time: f64 = labelled(&mut words, &["Frame", "Time:"])?;
    check_rate(1.0 / frame_time)?;
    let values: Vec<f64> = words.map(number).collect::<Result<_, _>>()?;
    let channels = joints.iter().map(|joint| joint.channels.len()).sum();
    if channels == 0 || frames.checked_mul(channels) != Some(values.len()) {
        let found = values.len();
        return Err(format!("{found} numbers are not {frames} frames of {channels} channels"));
    }
    let mut positions = Array3::zeros((frames, JOINTS, 3));
    let mut skeletal = skeleton(&joints, &order, scale);
    for (frame, values) in values.chunks_exact(channels).enumerate() {
        let Pose { places, local } = pose(&joints, values);
        for (joint, &at) in order.iter().enumerate() {
            for (axis, value) in (places[at] * scale).to_array().into_iter().enumerate() {
                positions[(frame, joint, axis)] = value as f32;
            }
        }
        skeletal.root.push(places[order[0]] * scale);
        skeletal.local.push(std::array::from_fn(|joint| local[order[joint]]));
    }
    skeletal.channel_jump = largest_jump(&joints, &values, channels);
    Ok((positions, skeletal))
}

/// Returns the rest skeleton, without frames. A joint whose parent is none of the 24 hangs on the
/// root.
fn skeleton(joints: &[Joint], order: &[usize], scale: f64) -> SkeletalMotion {
    let parent = |joint: usize| {
        let parent = joints[order[joint]].parent?;
        order.iter().position(|&at| at == parent)
    };
    SkeletalMotion {
        parents: std::array::from_fn(|joint| parent(joint).unwrap_or(0)),
        offsets: std::array::from_fn(|joint| joints[order[joint]].offset * scale),
        root: Vec::new(),
        local: Vec::new(),
        channel_jump: 0.0,
    }
}

/// Returns the largest change of a rotation channel from one frame to the next, degrees.
fn largest_jump(joints: &[Joint], values: &[f64], channels: usize) -> f64 {
    let all = joints.iter().flat_map(|joint| &joint.channels);
    let rotates: Vec<bool> = all.map(|channel| matches!(channel, Channel::Rotation(_))).collect();
    let pairs = values.iter().zip(values.iter().skip(channels));
    let jumps = pairs.zip(rotates.iter().cycle()).filter(|(_, rotates)| **rotates);
    jumps.map(|((before, now), _)| (now - before).abs()).fold(0.0, f64::max)
}

/// Reads the joints up to the word MOTION; a parent comes before its children.
fn hierarchy(words: &mut SplitWhitespace<'_>) -> Result<Vec<Joint>, String> {
    expect(words, "HIERARCHY")?;
    let mut joints: Vec<Joint> = Vec::new();
    // The joints whose brackets are open; none: an end site.
    let mut open: Vec<Option<usize>> = Vec::new();
    loop {
        match word(words)? {
            "ROOT" | "JOINT" => {
                joints.push(Joint {
                    name: word(words)?.to_owned(),
                    parent: open.last().copied().flatten(),
                    offset: DVec3::ZERO,
                    channels: Vec::new(),
                });
                expect(words, "{")?;
                open.push(Some(joints.len() - 1));
            }
            "End" => {
                expect(words, "Site")?;
                expect(words, "{")?;
                open.push(None);
            }
            "OFFSET" => {
                let offset = vector(words)?;
                if let Some(joint) = current(&open, &mut joints) {
                    joint.offset = offset;
                }
            }
            "CHANNELS" => {
                let channels = channels(words)?;
                let joint = current(&open, &mut joints).ok_or("channels without a joint")?;
                let moves = channels.iter().any(|c| matches!(c, Channel::Position(_)));
                if moves && joint.parent.is_some() {
                    let name = &joint.name;
                    return Err(format!("joint {name} has position channels: only the root may"));
                }
                joint.channels = channels;
            }
            "}" => {
                open.pop().ok_or("a bracket closes nothing")?;
            }
            "MOTION" => return Ok(joints),
            other => return Err(format!("the hierarchy holds {other:?}")),
        }
    }
}

fn current<'a>(open: &[Option<usize>], joints: &'a mut [Joint]) -> Option<&'a mut Joint> {
    joints.get_mut(open.last().copied().flatten()?)
}

fn channels(words: &mut SplitWhitespace<'_>) -> Result<Vec<Channel>, String> {
    let count = number(word(words)?)? as usize;
    (0..count.min(6))
        .map(|_| match word(words)? {
            "Xposition" => Ok(Channel::Position(0)),
            "Yposition" => Ok(Channel::Position(1)),
            "Zposition" => Ok(Channel::Position(2)),
            "Xrotation" => Ok(Channel::Rotation(DVec3::X)),
            "Yrotation" => Ok(Channel::Rotation(DVec3::Y)),
            "Zrotation" => Ok(Channel::Rotation(DVec3::Z)),
            other => Err(format!("there is no channel {other:?}")),
        })
        .collect()
}

/// Returns the place of each SMPL joint in the file.
fn smpl_order(joints: &[Joint]) -> Result<Vec<usize>, String> {
    let find = |name: &str| {
        let place = joints.iter().rposition(|joint| joint.name == name);
        place.ok_or(format!("it has no joint {name}"))
    };
    JOINT_NAMES.split_whitespace().map(find).collect()
}

/// Metres per unit. The format does not name one, but no leg is 5 m long.
fn metres(joints: &[Joint], order: &[usize]) -> f64 {
    let leg = [L_KNEE, L_ANKLE].map(|joint| joints[order[joint]].offset.length());
    match leg.iter().sum::<f64>() > LONGEST_LEG {
        true => METRES_PER_CENTIMETRE,
        false => 1.0,
    }
}

/// Places and local rotations of all joints of the file.
struct Pose {
    places: Vec<DVec3>,
    local: Vec<DQuat>,
}

/// Computes the pose of one line of channels.
fn pose(joints: &[Joint], values: &[f64]) -> Pose {
    let mut values = values.iter().copied();
    let mut places = Vec::with_capacity(joints.len());
    let mut rotations = Vec::with_capacity(joints.len());
    let mut turned: Vec<DQuat> = Vec::with_capacity(joints.len());
    for joint in joints {
        let mut shift = DVec3::ZERO;
        let mut local = DQuat::IDENTITY;
        for (channel, value) in joint.channels.iter().zip(&mut values) {
            match *channel {
                Channel::Position(axis) => shift[axis] += value,
                Channel::Rotation(axis) => {
                    local *= DQuat::from_axis_angle(axis, value.to_radians())
                }
            }
        }
        let (place, turn) = match joint.parent {
            None => (shift, local),
            Some(parent) => {
                (places[parent] + turned[parent] * joint.offset, turned[parent] * local)
            }
        };
        places.push(place);
        turned.push(turn);
        rotations.push(local);
    }
    Pose { places, local: rotations }
}

fn word<'a>(words: &mut SplitWhitespace<'a>) -> Result<&'a str, String> {
    words.next().ok_or_else(|| "the file ends too early".into())
}

fn expect(words: &mut SplitWhitespace<'_>, wanted: &str) -> Result<(), String> {
    match word(words)? {
        found if found == wanted => Ok(()),
        found => Err(format!("expected {wanted}, got {found:?}")),
    }
}

fn number(word: &str) -> Result<f64, String> {
    word.parse().map_err(|_| format!("{word:?} is no number"))
}

fn vector(words: &mut SplitWhitespace<'_>) -> Result<DVec3, String> {
    let mut next = || number(word(words)?);
    Ok(DVec3::new(next()?, next()?, next()?))
}

fn labelled<T: std::str::FromStr>(
    words: &mut SplitWhitespace<'_>,
    label: &[&str],
) -> Result<T, String> {
    for part in label {
        expect(words, part)?;
    }
    let value = word(words)?;
    let parsed = value.parse();
    parsed.map_err(|_| format!("{} {value:?} is no number", label.join(" ")))
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use super::*;

    /// Every joint a child of the pelvis, a unit along x, in reverse order; 2 frames of channels.
    fn file(unit: f64, frame_time: f64, root: [&str; 2]) -> String {
        let mut text = String::from("HIERARCHY\nROOT pelvis\n{\nOFFSET 0 0 0\n");
        text.push_str("CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n");
        for name in JOINT_NAMES.split_whitespace().skip(1).collect::<Vec<_>>().iter().rev() {
            writeln!(text, "JOINT {name} {{ OFFSET {unit} 0 0").unwrap();
            text.push_str("CHANNELS 3 Yrotation Xrotation Zrotation\n");
            writeln!(text, "End Site {{ OFFSET 0 {unit} 0 }} }}").unwrap();
        }
        writeln!(text, "}}\nMOTION\nFrames: 2\nFrame Time: {frame_time}").unwrap();
        for channels in root {
            writeln!(text, "{channels}{}", " 0 0 0".repeat(23)).unwrap();
        }
        text
    }

    const SIXTIETH: f64 = 0.016_666_67;

    fn at(positions: &Array3<f32>, frame: usize, joint: usize) -> [f32; 3] {
        [0, 1, 2].map(|axis| positions[(frame, joint, axis)])
    }

    #[test]
    fn channels_are_applied_in_their_order() {
        // Rz(90) * Ry(90) takes x to -z; the other order would take it to y.
        let text = file(1.0, SIXTIETH, ["1 2 3 0 0 0", "0 0 0 90 0 90"]);
        let (positions, rotations) = read(&text).unwrap();
        assert_eq!(rotations.channel_jump, 90.0);
        let [root, _] = rotations.local[..] else { panic!("two frames") };
        assert_eq!(root[0], DQuat::IDENTITY);
        assert_eq!(rotations.offsets[5], DVec3::X);
        assert_eq!(at(&positions, 0, 0), [1.0, 2.0, 3.0]);
        assert_eq!(at(&positions, 0, 17), [2.0, 2.0, 3.0]);
        let turned = at(&positions, 1, 5);
        assert!(turned[2] < -0.999 && turned[1].abs() < 1e-6, "{turned:?}");
    }

    #[test]
    fn centimetres_are_recognised_by_the_leg() {
        for (unit, root) in [(40.0, "100 0 0 0 0 0"), (0.4, "1 0 0 0 0 0")] {
            let (positions, _) = read(&file(unit, SIXTIETH, [root; 2])).unwrap();
            assert!((positions[(0, 7, 0)] - 1.4).abs() < 1e-6);
        }
    }

    #[test]
    fn errors_say_what_is_wrong() {
        const STILL: &str = "0 0 0 0 0 0";
        let good = file(1.0, SIXTIETH, [STILL; 2]);
        let with = |from: &str, to: &str| good.replace(from, to);
        for (text, words) in [
            (file(1.0, 1.0 / 30.0, [STILL; 2]), "frames a second"),
            (file(1.0, SIXTIETH, [STILL, "0 0 0 0 0"]), "149 numbers"),
            (with("l_hand", "paw"), "no joint l_hand"),
            (with("CHANNELS 3 Yrotation", "CHANNELS 3 Yposition"), "only the root"),
            (with("CHANNELS 3 Yrotation", "CHANNELS 3 Wrotation"), "Wrotation"),
            (with("Frames: 2", "Frames: 99999999999999999999"), "no number"),
            (with("Frames: 2", "Frames: 18446744073709551615"), "150 numbers"),
            ("HIERARCHY }".into(), "closes nothing"),
            ("HIERARCHY CHANNELS 0".into(), "without a joint"),
            (String::new(), "too early"),
            ("not a bvh".into(), "expected HIERARCHY"),
        ] {
            let message = read(&text).unwrap_err();
            assert!(message.contains(words), "{words}: {message}");
        }
    }
}
