//! GLB and VRM animation read back by the crate `gltf`.

use std::collections::HashMap;

use bailando_formats::{GeneratedMotion, GlbOptions, TargetSkeleton, to_glb, to_vrma};
use bailando_motion::{Positions, forward};
use bailando_testkit::motion::distances;
use glam::{DQuat, DVec3, Quat, Vec3};
use gltf::animation::util::ReadOutputs;

use crate::{
    motion, recorded,
    rigs::{slide, stepping},
    short,
};

/// Largest distance from forward kinematics, metres.
const TOLERANCE: f64 = 2e-3;
/// Most bytes of 30 s without a doll.
const MOST_BYTES: usize = 300_000;

#[test]
fn glb_read_back_has_the_joints_of_forward_kinematics() {
    let motion = motion(60);
    for skeleton in TargetSkeleton::ALL {
        let file = to_glb(&motion, GlbOptions { skeleton, mannequin: true }).unwrap();
        let largest = largest_error(&file, &motion);
        println!("{}: {largest:.2e} m, {} bytes", skeleton.name(), file.len());
        assert!(largest < TOLERANCE, "{skeleton:?}: {largest} m");
    }
}

#[test]
fn half_a_minute_of_glb_is_small_and_true() {
    for (name, motion) in recorded(60) {
        let mannequin = false;
        let file = to_glb(&motion, GlbOptions { mannequin, ..GlbOptions::default() }).unwrap();
        let largest = largest_error(&file, &motion);
        let frames = motion.animation.root.len();
        println!("{name}: {frames} frames, {} bytes, {largest:.2e} m", file.len());
        assert!(largest < TOLERANCE, "{name}: {largest} m");
        assert!(file.len() < MOST_BYTES, "{name}: {} bytes", file.len());
    }
}

#[test]
fn feet_stand_in_glb_as_they_do_in_json() {
    let mut dances = vec![("steps".to_owned(), stepping())];
    dances.extend(recorded(60));
    for (name, motion) in dances {
        let file = to_glb(&motion, GlbOptions::default()).unwrap();
        let positions = positions_in(&file, &motion);
        let [own, seen] = [&motion.positions, &positions].map(|p| slide(&motion, p));
        println!("{name}: balls slide {:.2} cm/s, in GLB {:.2}", 100.0 * own, 100.0 * seen);
        assert!(seen < own + 0.005, "{name}: {seen} m/s, before {own}");
    }
}

#[test]
fn the_doll_is_skinned_to_the_bones() {
    let motion = short(3);
    let file = to_glb(&motion, GlbOptions::default()).unwrap();
    let gltf = gltf::Gltf::from_slice(&file).unwrap();
    let blob = gltf.blob.as_deref().unwrap();
    let mesh = gltf.meshes().next().unwrap();
    let primitive = mesh.primitives().next().unwrap();
    let reader = primitive.reader(|_| Some(blob));
    let corners = reader.read_positions().unwrap().count();
    let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
    assert!(indices.iter().all(|&index| (index as usize) < corners));
    let skin = gltf.skins().next().unwrap();
    let joints: Vec<usize> = skin.joints().map(|node| node.index()).collect();
    assert_eq!(joints, (0..24).collect::<Vec<_>>());
    let matrices = skin.reader(|_| Some(blob)).read_inverse_bind_matrices().unwrap();
    assert_eq!(matrices.count(), 24);
    let used: std::collections::HashSet<u16> =
        reader.read_joints(0).unwrap().into_u16().map(|joints| joints[0]).collect();
    assert_eq!(used.len(), 22, "every bone but the hands' ends moves a piece");
    let bare = to_glb(&motion, GlbOptions { mannequin: false, ..GlbOptions::default() }).unwrap();
    let bare = gltf::Gltf::from_slice(&bare).unwrap();
    assert!(bare.meshes().next().is_none() && bare.skins().next().is_none());
}

#[test]
fn vrma_names_its_bones_and_moves_the_hips_alone() {
    let motion = motion(30);
    let file = to_vrma(&motion).unwrap();
    assert!(largest_error(&file, &motion) < 1e-4);
    let gltf = gltf::Gltf::from_slice(&file).unwrap();
    let extension = gltf.extension_value("VRMC_vrm_animation").unwrap();
    assert_eq!(extension["specVersion"], "1.0");
    let bones = extension["humanoid"]["humanBones"].as_object().unwrap();
    assert_eq!(bones.len(), 22);
    let nodes: Vec<_> = gltf.nodes().collect();
    for (bone, node) in bones {
        let node = &nodes[node["node"].as_u64().unwrap() as usize];
        assert_eq!(node.name(), Some(bone.as_str()));
        let (_, rotation, scale) = node.transform().decomposed();
        assert_eq!((rotation, scale), ([0.0, 0.0, 0.0, 1.0], [1.0; 3]), "{bone}");
    }
    for channel in gltf.animations().next().unwrap().channels() {
        let name = channel.target().node().name().unwrap().to_owned();
        match channel.target().property() {
            gltf::animation::Property::Rotation => assert!(bones.contains_key(&name)),
            gltf::animation::Property::Translation => assert_eq!(name, "hips"),
            other => panic!("{other:?} of {name}"),
        }
    }
    let hips = nodes[0].transform().decomposed().0;
    assert!((0.9..1.05).contains(&hips[1]), "{hips:?}");
}

/// A track: times in seconds with values.
struct Track<T> {
    times: Vec<f32>,
    values: Vec<T>,
}

impl<T: Copy> Track<T> {
    /// Values before and after a time, and how far it is from the one to the other.
    fn around(&self, time: f32) -> (T, T, f64) {
        let next = self.times.partition_point(|&t| t <= time).clamp(1, self.times.len().max(2) - 1);
        let (Some(&to), from) = (self.times.get(next), self.times[next - 1]) else {
            return (self.values[0], self.values[0], 0.0);
        };
        let part = f64::from((time - from) / (to - from));
        (self.values[next - 1], self.values[next], part.clamp(0.0, 1.0))
    }
}

#[derive(Default)]
struct Tracks {
    rotations: HashMap<usize, Track<DQuat>>,
    places: HashMap<usize, Track<DVec3>>,
}

fn tracks(gltf: &gltf::Gltf) -> Tracks {
    let blob = gltf.blob.as_deref().unwrap();
    let mut tracks = Tracks::default();
    for channel in gltf.animations().next().unwrap().channels() {
        let node = channel.target().node().index();
        let reader = channel.reader(|_| Some(blob));
        let times: Vec<f32> = reader.read_inputs().unwrap().collect();
        match reader.read_outputs().unwrap() {
            ReadOutputs::Rotations(rotations) => {
                let values = rotations.into_f32().map(|q| Quat::from_array(q).as_dquat());
                let values = values.map(DQuat::normalize).collect();
                tracks.rotations.insert(node, Track { times, values });
            }
            ReadOutputs::Translations(places) => {
                let values = places.map(|p| Vec3::from_array(p).as_dvec3()).collect();
                tracks.places.insert(node, Track { times, values });
            }
            _ => panic!("scales and weights stay"),
        }
    }
    tracks
}

/// The largest distance of a joint in a file from forward kinematics, metres.
fn largest_error(file: &[u8], motion: &GeneratedMotion) -> f64 {
    let expected = forward(&motion.skeleton, &motion.animation).unwrap();
    distances(&positions_in(file, motion), &expected).1
}

/// Where a file has the joints, `[frames, joints, 3]`.
fn positions_in(file: &[u8], motion: &GeneratedMotion) -> Positions {
    let gltf = gltf::Gltf::from_slice(file).unwrap();
    let tracks = tracks(&gltf);
    let mut parents = HashMap::new();
    for node in gltf.nodes() {
        parents.extend(node.children().map(|child| (child.index(), node.index())));
    }
    let nodes: Vec<_> = gltf.nodes().filter(|node| node.mesh().is_none()).collect();
    let first = nodes.len() - motion.skeleton.joints.len();
    let mut positions = Positions::zeros(motion.positions.dim());
    for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
        let time = (frame as f64 / f64::from(motion.animation.fps)) as f32;
        let mut world: Vec<(DVec3, DQuat)> = Vec::new();
        for node in &nodes {
            let (place, rotation, _) = node.transform().decomposed();
            let rest = Quat::from_array(rotation).as_dquat();
            let turn = tracks.rotations.get(&node.index()).map_or(rest, |track| {
                let (from, to, part) = track.around(time);
                from.slerp(to, part)
            });
            let place = Vec3::from_array(place).as_dvec3();
            let place = tracks.places.get(&node.index()).map_or(place, |track| {
                let (from, to, part) = track.around(time);
                from.lerp(to, part)
            });
            let above = parents.get(&node.index()).map(|&parent| world[parent]);
            let (above, turned) = above.unwrap_or((DVec3::ZERO, DQuat::IDENTITY));
            world.push((above + turned * place, turned * turn));
        }
        for (mut joint, (place, _)) in pose.outer_iter_mut().zip(&world[first..]) {
            joint.assign(&ndarray::arr1(&place.as_vec3().to_array()));
        }
    }
    positions
}
