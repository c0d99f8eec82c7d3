//! BVH: hierarchy and channels to joint positions by forward kinematics.
//!
//! Joints are found by their names, so that files of other programs with the same skeleton work in
//! any order of joints and channels. The root stands where its position channels say, as its OFFSET
//! is zero in our files.

use std::{collections::HashMap, str::SplitWhitespace};

use glam::{DQuat, DVec3};
use ndarray::Array3;

use super::check_rate;
use crate::body::{JOINT_NAMES, JOINTS};

/// Legs longer than this are measured in centimetres, not in metres.
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

/// Positions `[frames, 24, 3]` in metres, SMPL order.
pub(super) fn read(text: &str) -> Result<Array3<f32>, String> {
    let mut words = text.split_whitespace();
    let joints = hierarchy(&mut words)?;
    let order = smpl_order(&joints)?;
    let scale = metres(&joints, &order);
    let frames: usize = labelled(&mut words, &["Frames:"])?;
    let frame_time: f64 = labelled(&mut words, &["Frame", "Time:"])?;
    check_rate(1.0 / frame_time)?;
    let values: Vec<f64> = words.map(number).collect::<Result<_, _>>()?;
    let channels = joints
        .iter()
        .map(|joint| joint.channels.len())
        .sum::<usize>();
    if channels == 0 || frames.checked_mul(channels) != Some(values.len()) {
        return Err(format!(
            "{} numbers are not {frames} frames of {channels} channels",
            values.len()
        ));
    }
    let mut positions = Array3::zeros((frames, JOINTS, 3));
    for (mut cells, values) in positions
        .outer_iter_mut()
        .zip(values.chunks_exact(channels))
    {
        let places = pose(&joints, values);
        for (mut cell, &at) in cells.outer_iter_mut().zip(&order) {
            let place = (places[at] * scale).as_vec3().to_array();
            cell.iter_mut()
                .zip(place)
                .for_each(|(value, new)| *value = new);
        }
    }
    Ok(positions)
}

/// The joints up to the word MOTION; a parent comes before its children.
fn hierarchy(words: &mut SplitWhitespace<'_>) -> Result<Vec<Joint>, String> {
    expect(words, "HIERARCHY")?;
    let mut joints: Vec<Joint> = Vec::new();
    // The joints that are open; an end site is nobody.
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
                if joint.parent.is_some()
                    && channels.iter().any(|c| matches!(c, Channel::Position(_)))
                {
                    return Err(format!(
                        "joint {} has position channels: only the root may",
                        joint.name
                    ));
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

/// Where in the file each SMPL joint is.
fn smpl_order(joints: &[Joint]) -> Result<Vec<usize>, String> {
    let places: HashMap<&str, usize> = joints
        .iter()
        .enumerate()
        .map(|(at, joint)| (joint.name.as_str(), at))
        .collect();
    let find = |name: &&str| {
        places
            .get(name)
            .copied()
            .ok_or(format!("it has no joint {name}"))
    };
    JOINT_NAMES.iter().map(find).collect()
}

/// Metres per unit. The format does not name one: nobody's leg is 5 m long.
fn metres(joints: &[Joint], order: &[usize]) -> f64 {
    let leg = [4, 7]
        .iter()
        .filter_map(|&joint| joints.get(*order.get(joint)?));
    let length: f64 = leg.map(|joint| joint.offset.length()).sum();
    if length > LONGEST_LEG {
        METRES_PER_CENTIMETRE
    } else {
        1.0
    }
}

/// Places of all joints for one line of channels.
fn pose(joints: &[Joint], values: &[f64]) -> Vec<DVec3> {
    let mut values = values.iter().copied();
    let mut places = Vec::with_capacity(joints.len());
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
            Some(parent) => (
                places[parent] + turned[parent] * joint.offset,
                turned[parent] * local,
            ),
        };
        places.push(place);
        turned.push(turn);
    }
    places
}

fn word<'a>(words: &mut SplitWhitespace<'a>) -> Result<&'a str, String> {
    words
        .next()
        .ok_or_else(|| "the file ends too early".to_owned())
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
    value
        .parse()
        .map_err(|_| format!("{} {value:?} is no number", label.join(" ")))
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use super::*;

    /// Every joint a child of the pelvis, a unit along x, in reverse order; 2 frames of channels.
    fn file(unit: f64, frame_time: f64, root: [&str; 2]) -> String {
        let mut text = String::from("HIERARCHY\nROOT pelvis\n{\nOFFSET 0 0 0\n");
        text.push_str("CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n");
        for name in JOINT_NAMES[1..].iter().rev() {
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
        let positions = read(&text).unwrap();
        assert_eq!(at(&positions, 0, 0), [1.0, 2.0, 3.0]);
        assert_eq!(at(&positions, 0, 17), [2.0, 2.0, 3.0]);
        let turned = at(&positions, 1, 5);
        assert!(turned[2] < -0.999 && turned[1].abs() < 1e-6, "{turned:?}");
    }

    #[test]
    fn centimetres_are_told_from_metres() {
        let positions = read(&file(40.0, SIXTIETH, ["100 0 0 0 0 0"; 2])).unwrap();
        assert!((positions[(0, 7, 0)] - 1.4).abs() < 1e-6);
        let positions = read(&file(0.4, SIXTIETH, ["1 0 0 0 0 0"; 2])).unwrap();
        assert!((positions[(0, 7, 0)] - 1.4).abs() < 1e-6);
    }

    #[test]
    fn what_is_wrong_is_said() {
        let good = file(1.0, SIXTIETH, ["0 0 0 0 0 0"; 2]);
        for (text, words) in [
            (file(1.0, 1.0 / 30.0, ["0 0 0 0 0 0"; 2]), "frames a second"),
            (
                file(1.0, SIXTIETH, ["0 0 0 0 0 0", "0 0 0 0 0"]),
                "149 numbers",
            ),
            (good.replace("l_hand", "paw"), "no joint l_hand"),
            (
                good.replace("CHANNELS 3 Yrotation", "CHANNELS 3 Yposition"),
                "only the root",
            ),
            (
                good.replace("CHANNELS 3 Yrotation", "CHANNELS 3 Wrotation"),
                "Wrotation",
            ),
            (
                good.replace("Frames: 2", "Frames: 99999999999999999999"),
                "no number",
            ),
            (
                good.replace("Frames: 2", "Frames: 18446744073709551615"),
                "150 numbers",
            ),
            ("HIERARCHY }".to_owned(), "closes nothing"),
            ("HIERARCHY CHANNELS 0".to_owned(), "without a joint"),
            (String::new(), "too early"),
            ("not a bvh".to_owned(), "expected HIERARCHY"),
        ] {
            let message = read(&text).unwrap_err();
            assert!(message.contains(words), "{words}: {message}");
        }
    }
}
