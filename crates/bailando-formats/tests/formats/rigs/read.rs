//! Dances on rigs read back: GLB by the crate `gltf`, BVH by a parser of this test.

use std::collections::HashMap;

use glam::{DQuat, DVec3, Quat, Vec3};
use gltf::animation::util::ReadOutputs;

/// World places and rotations of named bones, frame by frame.
pub(super) type Danced = Vec<HashMap<String, (DVec3, DQuat)>>;

pub(super) fn read_back(file: &[u8]) -> Danced {
    if file.starts_with(b"glTF") { read_glb(file) } else { read_bvh(file) }
}

/// A GLB's last animation, frame by frame at 60 fps.
fn read_glb(file: &[u8]) -> Danced {
    let gltf = gltf::Gltf::from_slice(file).unwrap();
    let blob = gltf.blob.as_deref().unwrap();
    let mut turns: HashMap<usize, (Vec<f32>, Vec<DQuat>)> = HashMap::new();
    let mut places: HashMap<usize, (Vec<f32>, Vec<DVec3>)> = HashMap::new();
    let mut end = 0.0_f32;
    for channel in gltf.animations().last().unwrap().channels() {
        let node = channel.target().node().index();
        let reader = channel.reader(|_| Some(blob));
        let times: Vec<f32> = reader.read_inputs().unwrap().collect();
        end = end.max(times[times.len() - 1]);
        match reader.read_outputs().unwrap() {
            ReadOutputs::Rotations(all) => {
                let all = all.into_f32().map(|q| Quat::from_array(q).as_dquat()).collect();
                turns.insert(node, (times, all));
            }
            ReadOutputs::Translations(all) => {
                let all = all.map(|p| Vec3::from_array(p).as_dvec3()).collect();
                places.insert(node, (times, all));
            }
            _ => panic!("scales and weights stay"),
        }
    }
    let mut parents = HashMap::new();
    for node in gltf.nodes() {
        parents.extend(node.children().map(|child| (child.index(), node.index())));
    }
    let at_rest = |node: gltf::Node<'_>| {
        let (place, turn, scale) = node.transform().decomposed();
        let turn = Quat::from_array(turn).as_dquat();
        (Vec3::from(place).as_dvec3(), turn, f64::from(scale[0]))
    };
    let rest: Vec<(DVec3, DQuat, f64)> = gltf.nodes().map(at_rest).collect();
    let frames = (end * 60.0).round() as usize + 1;
    let pose = |frame: usize| {
        let time = frame as f32 / 60.0;
        let around = |times: &[f32]| {
            let next = times.partition_point(|&t| t <= time).clamp(1, times.len().max(2) - 1);
            let part =
                (time - times[next - 1]) / (times[next.min(times.len() - 1)] - times[next - 1]);
            (next - 1, next.min(times.len() - 1), f64::from(part.clamp(0.0, 1.0)))
        };
        let local = |index: usize| {
            let (mut place, mut turn, scale) = rest[index];
            if let Some((times, all)) = turns.get(&index) {
                let (from, to, part) = around(times);
                turn = all[from].slerp(all[to], part);
            }
            if let Some((times, all)) = places.get(&index) {
                let (from, to, part) = around(times);
                place = all[from].lerp(all[to], part);
            }
            (place, turn, scale)
        };
        let locals: Vec<_> = (0..rest.len()).map(local).collect();
        let world = |index: usize| {
            let mut chain = vec![index];
            while let Some(&parent) = parents.get(&chain[chain.len() - 1]) {
                chain.push(parent);
            }
            let start = (DVec3::ZERO, DQuat::IDENTITY, 1.0);
            let world = chain.iter().rev().fold(start, |(place, turn, scale), &at| {
                let (own, turned, scaled) = locals[at];
                (place + turn * (own * scale), turn * turned, scale * scaled)
            });
            (world.0, world.1)
        };
        gltf.nodes().map(|node| (node.name().unwrap().to_owned(), world(node.index()))).collect()
    };
    (0..frames).map(pose).collect()
}

/// A BVH's motion.
fn read_bvh(file: &[u8]) -> Danced {
    struct Joint {
        name: String,
        parent: Option<usize>,
        offset: DVec3,
        channels: Vec<String>,
    }
    let text = std::str::from_utf8(file).unwrap();
    let (mut joints, mut open): (Vec<Joint>, Vec<usize>) = (Vec::new(), Vec::new());
    let mut lines = text.lines();
    for line in lines.by_ref() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[0] {
            "ROOT" | "JOINT" | "End" => {
                joints.push(Joint {
                    name: words[1].into(),
                    parent: open.last().copied(),
                    offset: DVec3::ZERO,
                    channels: Vec::new(),
                });
                open.push(joints.len() - 1);
            }
            "OFFSET" => {
                let numbers: Vec<f64> =
                    words[1..].iter().map(|word| word.parse().unwrap()).collect();
                joints[open[open.len() - 1]].offset = DVec3::from_slice(&numbers);
            }
            "CHANNELS" => {
                let channels = words[2..].iter().map(|word| (*word).to_owned()).collect();
                joints[open[open.len() - 1]].channels = channels;
            }
            "}" => drop(open.pop()),
            "MOTION" => break,
            _ => {}
        }
    }
    let axis = |name: &str| [DVec3::X, DVec3::Y, DVec3::Z][(name.as_bytes()[0] - b'X') as usize];
    let pose = |line: &str| {
        let mut numbers = line.split_whitespace().map(|word| word.parse::<f64>().unwrap());
        let mut world: Vec<(DVec3, DQuat)> = Vec::new();
        for joint in &joints {
            let (above, around) =
                joint.parent.map_or((DVec3::ZERO, DQuat::IDENTITY), |parent| world[parent]);
            let mut place = joint.offset;
            let mut turn = DQuat::IDENTITY;
            for channel in &joint.channels {
                let value = numbers.next().unwrap();
                match channel.ends_with("position") {
                    true => place[axis(channel).max_position()] = value,
                    false => turn *= DQuat::from_axis_angle(axis(channel), value.to_radians()),
                }
            }
            world.push((above + around * place, around * turn));
        }
        assert!(numbers.next().is_none());
        joints.iter().map(|joint| joint.name.clone()).zip(world).collect()
    };
    lines.skip(2).map(pose).collect()
}
