//! Dances on callers' own characters: read back, they dance as the dancer does and stand on the
//! floor; nothing else of their files has changed. Hostile files are refused in words.

mod hostile;
mod read;

use bailando_formats::{
    BoneNames, Character, FoundBy, GeneratedMotion, RigFormat, RigLimits, RigMapping,
};
use bailando_motion::{FinishOptions, Positions};
use bailando_testkit::{
    motion::{dance_of, decoded_from},
    rigs::{self, Rig},
};
use glam::{DQuat, DVec3};
use serde_json::Value;

use crate::{recorded, short};
use read::{Danced, read_back};

fn read(rig: &Rig) -> Character {
    let read = Character::read(rig.bytes.clone(), &RigMapping::default(), &RigLimits::default());
    read.unwrap_or_else(|error| panic!("{}: {error}", rig.name))
}

/// What is measured of feet.
struct Feet {
    /// Median speed of balls within 5 cm of the floor, m/s.
    skate: f64,
    /// Lowest edge of a sole, at heel or ball, or tip of toes, against where it stands at rest,
    /// metres.
    lowest: f64,
}

fn up(rig: &Rig) -> DVec3 {
    let line = rig.body.bone("head").place - rig.body.bone("hips").place;
    let mut up = DVec3::ZERO;
    up[line.abs().max_position()] = 1.0;
    up
}

fn feet(rig: &Rig, danced: &Danced, fps: f64) -> Feet {
    let up = up(rig);
    let (mut speeds, mut lowest) = (Vec::new(), f64::INFINITY);
    for (side, [ankle, ball]) in ["l", "r"].into_iter().zip(&rig.feet) {
        let rest = |part: &str| rig.body.bone(&format!("{side}_{part}"));
        let (foot, toes) = (rest("foot"), rest("toes"));
        let ahead = toes.place - foot.place;
        let level = ahead - up * ahead.dot(up);
        let heel = up * ahead.dot(up) - level * 0.4;
        let edge = up.cross(level) * 0.35;
        let floor = toes.place.dot(up);
        let end = rest("toe_end").place - toes.place;
        let path: Vec<(DVec3, f64)> = danced
            .iter()
            .map(|frame| {
                let (place, turn) = frame[ankle];
                let turned = turn * foot.axes.inverse();
                let heel = place / rig.unit + turned * heel;
                let (place, turn) = frame[ball];
                let ball = place / rig.unit;
                // The tip of the toes, as high as at rest.
                let tip = ball + turn * toes.axes.inverse() * end;
                lowest = lowest.min((tip - toes.place - end).dot(up));
                for middle in [heel, ball] {
                    let below = (turned * edge).dot(up).abs();
                    lowest = lowest.min(middle.dot(up) - below - floor);
                }
                (ball - up * ball.dot(up), ball.dot(up) - floor)
            })
            .collect();
        let steps = path.windows(2).filter(|pair| pair.iter().all(|(_, height)| *height < 0.05));
        speeds.extend(steps.map(|pair| pair[0].0.distance(pair[1].0) * fps));
    }
    speeds.sort_by(f64::total_cmp);
    assert!(speeds.len() > 20, "{}: feet do not come to the floor", rig.name);
    Feet { skate: speeds[speeds.len() / 2], lowest }
}

/// Largest angle in degrees between upper and lower arms and legs of rig and dancer.
fn limbs(rig: &Rig, danced: &Danced, motion: &GeneratedMotion) -> f64 {
    let up = up(rig);
    let left = up.cross(rig.ahead);
    let into = |v: DVec3| DVec3::new(v.dot(left), v.dot(up), v.dot(rig.ahead));
    let joint = |name: &str| motion.skeleton.joints.iter().position(|joint| joint == name).unwrap();
    let mut largest = 0.0_f64;
    for (frame, pose) in danced.iter().zip(motion.positions.outer_iter()) {
        let place = |name: &str| {
            let row = pose.row(joint(name));
            DVec3::new(row[0].into(), row[1].into(), row[2].into())
        };
        for side in ["l", "r"] {
            for (from, to, first, last) in [
                ("upper_arm", "lower_arm", "shoulder", "elbow"),
                ("lower_arm", "hand", "elbow", "wrist"),
            ] {
                let own = |part: &str| frame[&rig.body.name(&format!("{side}_{part}"))].0;
                let found = into(own(to) - own(from));
                let wanted = place(&format!("{side}_{last}")) - place(&format!("{side}_{first}"));
                largest = largest.max(found.angle_between(wanted).to_degrees());
            }
        }
    }
    largest
}

/// A dancer who sways and steps to the left and to the right, a foot a second.
pub(crate) fn stepping() -> GeneratedMotion {
    let skeleton = bailando_testkit::motion::skeleton();
    let mut rest = vec![DVec3::Y * 0.95; 24];
    for joint in 1..24 {
        let parent = skeleton.parent(joint).unwrap();
        rest[joint] = rest[parent] + skeleton.offset(joint).as_dvec3();
    }
    let smooth = |t: f64| t.clamp(0.0, 1.0).powi(2) * (3.0 - 2.0 * t.clamp(0.0, 1.0));
    let positions = ndarray::Array3::from_shape_fn((480, 24, 3), |(frame, joint, axis)| {
        let time = frame as f64 / 60.0;
        // Where a foot is that steps in odd or in even seconds.
        let step = |parity: f64| {
            let second = (0.5 * (time - parity)).rem_euclid(2.0);
            let part = smooth(2.0 * second) - smooth(2.0 * second - 2.0);
            let lifted = (std::f64::consts::TAU * second.rem_euclid(1.0)).sin().max(0.0);
            DVec3::new(0.15 * part, 0.1 * lifted * lifted, 0.05 * part)
        };
        let (left, right) = (step(0.0), step(1.0));
        let body =
            0.5 * (left + right).with_y(0.0) + DVec3::new(0.02 * (2.0 * time).sin(), -0.04, 0.0);
        let turn = DQuat::from_rotation_y(0.3 * (1.5 * time).sin());
        let turned = rest[0] + turn * (rest[joint] - rest[0]) + body;
        let foot = |step: DVec3| rest[joint] + step;
        let place = match joint {
            7 | 10 => foot(left),
            8 | 11 => foot(right),
            4 | 5 => {
                let (hip, ankle) = if joint == 4 { (1, 7) } else { (2, 8) };
                let step = if joint == 4 { left } else { right };
                let hip = rest[0] + turn * (rest[hip] - rest[0]) + body;
                hip.lerp(rest[ankle] + step, 0.48) + DVec3::Z * 0.1
            }
            _ => turned,
        };
        place[axis] as f32
    });
    dance_of(&decoded_from(&positions), &FinishOptions::default())
}

/// Median speed in m/s of the dancer's balls within 5 cm of the floor, for these joints.
pub(crate) fn slide(motion: &GeneratedMotion, positions: &Positions) -> f64 {
    let mut speeds = Vec::new();
    for name in ["l_foot", "r_foot"] {
        let foot = motion.skeleton.joints.iter().position(|joint| joint == name).unwrap();
        let at = |frame: usize| {
            let [x, y, z] = [0, 1, 2].map(|axis| f64::from(positions[[frame, foot, axis]]));
            DVec3::new(x, y - 0.015, z)
        };
        for frame in 1..motion.animation.root.len() {
            let [a, b] = [at(frame - 1), at(frame)];
            if a.y.max(b.y) < 0.05 {
                speeds.push((b - a).with_y(0.0).length() * 60.0);
            }
        }
    }
    speeds.sort_by(f64::total_cmp);
    speeds[speeds.len() / 2]
}

#[test]
fn every_rig_dances_as_the_dancer_does_with_its_feet_on_the_floor() {
    let mut dances = vec![("steps".to_owned(), stepping())];
    dances.extend(recorded(60));
    let mut wrong = Vec::new();
    for (name, dance) in &dances {
        let of_dancer = slide(dance, &dance.positions);
        println!("{name}: the dancer's feet slide {:.2} cm/s", 100.0 * of_dancer);
        for rig in rigs::all() {
            let character = read(&rig);
            let file = character.dance(dance, true).unwrap();
            let most = character.most_bytes(dance.animation.root.len());
            assert!(file.len() <= most, "{}: {} of {most} bytes", rig.name, file.len());
            let danced = read_back(&file);
            assert!(danced.len() >= dance.animation.root.len());
            let danced = danced[..dance.animation.root.len()].to_vec();
            let Feet { skate, lowest } = feet(&rig, &danced, 60.0);
            let angle = limbs(&rig, &danced, dance);
            println!(
                "{}, {name}: feet slide {:.2} cm/s, lowest sole {:.2} cm, arms within {angle:.2} \
                 degrees, {} bytes",
                rig.name,
                100.0 * skate,
                100.0 * lowest,
                file.len()
            );
            if skate > of_dancer.max(0.01) * 1.5 || lowest < -0.005 || angle > 1.0 {
                wrong.push(format!("{}, {name}: {skate} m/s, {lowest} m, {angle}", rig.name));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn bones_are_found_as_the_file_says_by_name_and_by_shape() {
    let expected = [
        (FoundBy::Names, RigFormat::Glb),
        (FoundBy::Humanoid, RigFormat::Vrm),
        (FoundBy::Humanoid, RigFormat::Vrm),
        (FoundBy::Names, RigFormat::Glb),
        (FoundBy::Names, RigFormat::Bvh),
        (FoundBy::Shape, RigFormat::Glb),
    ];
    let spines = [3, 3, 3, 5, 4, 3];
    for ((rig, expected), spine) in rigs::all().iter().zip(expected).zip(spines) {
        let character = read(rig);
        let mapping = character.mapping();
        assert_eq!((mapping.found_by.unwrap(), character.format()), expected, "{}", rig.name);
        let body = &rig.body;
        let mut one = vec![("hips".to_owned(), "hips".to_owned()), ("head".into(), "head".into())];
        for (side, prefix) in [("l", "left"), ("r", "right")] {
            for (part, name) in [
                ("shoulder", "Shoulder"),
                ("upper_arm", "UpperArm"),
                ("lower_arm", "LowerArm"),
                ("hand", "Hand"),
                ("upper_leg", "UpperLeg"),
                ("lower_leg", "LowerLeg"),
                ("foot", "Foot"),
                ("toes", "Toes"),
            ] {
                one.push((format!("{side}_{part}"), format!("{prefix}{name}")));
            }
        }
        for (part, name) in one {
            let wanted = BoneNames::One(body.name(&part));
            assert_eq!(mapping.bones.get(&name), Some(&wanted), "{}: {name}", rig.name);
        }
        let BoneNames::Several(found) = &mapping.bones["spine"] else { panic!("one spine") };
        assert_eq!(found.len(), spine, "{}: {found:?}", rig.name);
        // What is told can be given.
        let again = Character::read(rig.bytes.clone(), mapping, &RigLimits::default()).unwrap();
        assert_eq!(again.mapping().bones, mapping.bones);
    }
}

#[test]
fn a_given_mapping_wins_and_a_wrong_one_is_refused() {
    let rig = rigs::unnamed();
    let with = |part: &str, names: BoneNames| {
        let bones = [(part.to_owned(), names)].into_iter().collect();
        let mapping = RigMapping { found_by: None, bones };
        Character::read(rig.bytes.clone(), &mapping, &RigLimits::default())
    };
    let name = |part: &str| BoneNames::One(rig.body.name(part));
    let head = with("head", name("head_end")).unwrap();
    assert_eq!(head.mapping().bones["head"], name("head_end"));
    let none = with("leftToes", BoneNames::Several(Vec::new())).unwrap();
    assert!(!none.mapping().bones.contains_key("leftToes"));
    assert!(none.dance(&short(30), true).is_ok());
    for (part, names, expected) in [
        ("leftLowerLeg", name("l_hand"), "does not hang on"),
        ("leftLowerLeg", BoneNames::One("tail".into()), "`tail`, which it does not have"),
        ("tail", name("hips"), "there are hips, spine, neck, head, leftShoulder"),
        ("hips", BoneNames::Several(Vec::new()), "no bone for `hips`"),
    ] {
        let error = with(part, names).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn nothing_else_of_a_file_changes() {
    for rig in rigs::all() {
        let character = read(&rig);
        let file = character.dance(&short(20), true).unwrap();
        if character.format() == RigFormat::Bvh {
            let end = rig.bytes.windows(6).position(|word| word == b"MOTION").unwrap();
            assert!(file[..end] == rig.bytes[..end], "the hierarchy");
            assert!(!file.windows(2).any(|pair| pair[1] == b'\n' && pair[0] != b'\r'));
            continue;
        }
        let (before, binary_before) = chunks(&rig.bytes);
        let (after, binary) = chunks(&file);
        assert_eq!(binary[..binary_before.len()], *binary_before);
        let secret = "\"secret\": 1.10, \"big\": 12345678901234567890123, \"e\":1.50e-0";
        assert!(after.contains(secret) && before.contains(secret));
        let [mut before, mut after]: [Value; 2] =
            [before, after].map(|json| serde_json::from_str(json).unwrap());
        for (array, added) in
            [("accessors", None), ("bufferViews", Some(1)), ("animations", Some(1))]
        {
            let count = before[array].as_array().map_or(0, Vec::len);
            let all = after[array].as_array_mut().unwrap();
            assert!(added.is_none_or(|added| all.len() == count + added));
            all.truncate(count);
            if count == 0 {
                after.as_object_mut().unwrap().remove(array);
            }
        }
        after["buffers"][0]["byteLength"] = before["buffers"][0]["byteLength"].clone();
        for nodes in [&mut before["nodes"], &mut after["nodes"]] {
            for node in nodes.as_array_mut().unwrap() {
                // A matrix becomes its parts: the next check reads both.
                for key in ["matrix", "translation", "rotation", "scale"] {
                    if rig.name.contains("VRM 1") {
                        node.as_object_mut().unwrap().remove(key);
                    }
                }
            }
        }
        assert_eq!(before, after, "{}", rig.name);
        assert!(gltf::Gltf::from_slice(&file).is_ok());
        // A second dance takes the place of the first, and leaves animations of other names.
        let again = |file: Vec<u8>| {
            let read = Character::read(file, &RigMapping::default(), &RigLimits::default());
            read.unwrap().dance(&short(10), false).unwrap()
        };
        let count = |file: &[u8]| gltf::Gltf::from_slice(file).unwrap().animations().count();
        let waltz = chunks(&file).0.replace("\"Dance\"", "\"Waltz\"");
        let mut other = file.clone();
        other[20..20 + waltz.len()].copy_from_slice(waltz.as_bytes());
        assert_eq!([count(&again(file)), count(&again(other))], [1, 2]);
    }
}

#[test]
fn a_dance_without_frames_leaves_the_rig_as_it_is() {
    let rig = rigs::mixamo(1.0);
    assert!(read(&rig).dance(&short(0), true).unwrap() == rig.bytes);
    let bvh = rigs::bvh_of_60_joints();
    let file = read(&bvh).dance(&short(0), true).unwrap();
    assert!(String::from_utf8(file).unwrap().contains("Frames: 0\r\n"));
}

fn chunks(file: &[u8]) -> (&str, &[u8]) {
    let size = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
    let json = &file[20..20 + size(12)];
    let start = 20 + json.len();
    let binary = &file[start + 8..start + 8 + size(start)];
    assert_eq!(start + 8 + binary.len(), file.len());
    (std::str::from_utf8(json).unwrap(), binary)
}
