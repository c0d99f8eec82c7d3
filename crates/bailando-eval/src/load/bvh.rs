//! Our BVH: joint positions and local rotations of the 24 joints.
//!
//! Joints are found by their names, so that files of other programs with the same skeleton work in
//! any order of joints and channels. The root's place is that of its position channels, as its
//! OFFSET is zero in our files.

use ndarray::Array3;

use crate::{
    body::{
        JOINT_NAMES, JOINTS, SkeletalMotion, check_rate,
        joint::{L_ANKLE, L_KNEE},
    },
    bvh::{BvhFile, BvhJoint, Channel},
};

/// A longer leg is measured in centimetres, not in metres.
const LONGEST_LEG: f64 = 5.0;
const METRES_PER_CENTIMETRE: f64 = 0.01;

/// Returns positions `[frames, 24, 3]` in metres, SMPL order, and the rotations behind them.
pub(super) fn read(text: &str) -> Result<(Array3<f32>, SkeletalMotion), String> {
    let file = BvhFile::parse(text)?;
    check_channels(&file.joints)?;
    check_rate(file.frames_per_second)?;
    let order = smpl_order(&file.joints)?;
    let scale = metres(&file.joints, &order);
    let frames = file.frames();
    let mut positions = Array3::zeros((frames, JOINTS, 3));
    let mut skeletal = skeleton(&file.joints, &order, scale);
    for frame in 0..frames {
        let pose = file.pose(frame);
        for (joint, &at) in order.iter().enumerate() {
            for (axis, value) in (pose.places[at] * scale).to_array().into_iter().enumerate() {
                positions[(frame, joint, axis)] = value as f32;
            }
        }
        skeletal.root.push(pose.places[order[0]] * scale);
        skeletal.local.push(std::array::from_fn(|joint| pose.local[order[joint]]));
    }
    skeletal.channel_jump = largest_jump(&file);
    Ok((positions, skeletal))
}

/// Our files move the root alone; other joints that move would change the bones.
fn check_channels(joints: &[BvhJoint]) -> Result<(), String> {
    let moves = |joint: &&BvhJoint| {
        let mut channels = joint.channels.iter();
        joint.parent.is_some() && channels.any(|c| matches!(c, Channel::Position(_)))
    };
    match joints.iter().find(moves) {
        Some(BvhJoint { name, .. }) => {
            Err(format!("joint {name} has position channels: only the root may"))
        }
        None => Ok(()),
    }
}

/// Returns the rest skeleton, without frames. A joint whose parent is none of the 24 hangs on the
/// root.
fn skeleton(joints: &[BvhJoint], order: &[usize], scale: f64) -> SkeletalMotion {
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
fn largest_jump(file: &BvhFile) -> f64 {
    let BvhFile { joints, values, channels, .. } = file;
    let all = joints.iter().flat_map(|joint| &joint.channels);
    let rotates: Vec<bool> = all.map(|channel| matches!(channel, Channel::Rotation(_))).collect();
    let pairs = values.iter().zip(values.iter().skip(*channels));
    let jumps = pairs.zip(rotates.iter().cycle()).filter(|(_, rotates)| **rotates);
    jumps.map(|((before, now), _)| (now - before).abs()).fold(0.0, f64::max)
}

/// Returns the place of each SMPL joint in the file.
fn smpl_order(joints: &[BvhJoint]) -> Result<Vec<usize>, String> {
    let find = |name: &str| {
        let place = joints.iter().rposition(|joint| joint.name == name);
        place.ok_or(format!("it has no joint {name}"))
    };
    JOINT_NAMES.split_whitespace().map(find).collect()
}

/// Metres per unit. The format does not name one, but no leg is 5 m long.
fn metres(joints: &[BvhJoint], order: &[usize]) -> f64 {
    let leg = [L_KNEE, L_ANKLE].map(|joint| joints[order[joint]].offset.length());
    match leg.iter().sum::<f64>() > LONGEST_LEG {
        true => METRES_PER_CENTIMETRE,
        false => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use glam::{DQuat, DVec3};

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
