//! GLB (binary glTF 2.0): bones, their animation, and a doll that dances.
//!
//! Metres, y up, right-handed, heading for +z. The rest pose stands on the floor.

use glam::{DQuat, Mat4};
use gltf_json::{
    Accessor, Index, Material, Mesh, Node, Skin,
    accessor::{ComponentType, Type},
    animation::{self, Property},
    buffer,
    material::{PbrBaseColorFactor, PbrMetallicRoughness, StrengthFactor},
    mesh::{Mode, Primitive, Semantic},
    validation::Checked::{self, Valid},
};

use crate::{
    blob,
    error::FormatError,
    gltf::{Document, Layout, push_channel},
    keys::{Keys, reduce_rotations},
    mannequin::mannequin,
    motion::{GeneratedMotion, MotionSize},
    rig::Rig,
    target::TargetSkeleton,
};

/// Name of the animation in every format that names it.
pub(crate) const TAKE: &str = "Dance";
/// Largest error of a rotation: a tenth of a degree.
const ROTATION_TOLERANCE: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// Largest error in radians of a bone of which the farthest joint below is a metre away.
const REACH_TOLERANCE: f64 = 4.5e-4;
/// Bytes of the doll, names and JSON.
const FIXED_BYTES: usize = 160_000;

/// About the most bytes of a motion as GLB.
pub(crate) fn glb_bytes(size: MotionSize) -> usize {
    let joints = size.joints + 1;
    FIXED_BYTES + 1024 * joints + (8 * joints + 16) * size.frames
}

/// Contents of a GLB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GlbOptions {
    /// The skeleton whose names, rest pose and axes the bones have.
    pub skeleton: TargetSkeleton,
    /// Whether a doll is there; a skeleton that is not SMPL's has none.
    pub mannequin: bool,
}

impl Default for GlbOptions {
    fn default() -> Self {
        Self { skeleton: TargetSkeleton::default(), mannequin: true }
    }
}

/// Writes a motion as GLB.
///
/// # Errors
/// [`FormatError::Inconsistent`] if its parts do not fit each other or hold a NaN or an infinity,
/// [`FormatError::Skeleton`] if the model has joints that the target does not know.
pub fn to_glb(motion: &GeneratedMotion, options: GlbOptions) -> Result<Vec<u8>, FormatError> {
    motion.check()?;
    let rig = Rig::new(&motion.skeleton, options.skeleton, true)?;
    let mut document = Document::new(glb_bytes(motion.size()));
    document.bones(&rig);
    let mut roots = vec![Index::new(0)];
    let doll = options.mannequin.then(|| mannequin(&motion.skeleton, &rig)).flatten();
    if let Some(doll) = doll {
        roots.push(push_doll(&mut document, &rig, &doll));
    }
    document.scene(roots);
    if !motion.animation.root.is_empty() {
        push_animation(&mut document, &rig, motion);
    }
    document.into_glb()
}

/// Adds the doll, skinned to the bones; returns its node.
fn push_doll(document: &mut Document, rig: &Rig, doll: &blob::Mesh) -> Index<Node> {
    let to_bone = |bone: &crate::rig::Bone| {
        Mat4::from_rotation_translation(bone.axes.as_quat(), bone.position.as_vec3()).inverse()
    };
    let matrices: Vec<Mat4> = rig.bones.iter().map(to_bone).collect();
    let inverse_bind_matrices = Some(document.matrices(&matrices));
    let skin = document.root.push(Skin {
        extensions: None,
        extras: Default::default(),
        inverse_bind_matrices,
        joints: (0..rig.bones.len() as u32).map(Index::new).collect(),
        name: None,
        skeleton: None,
    });
    let primitive = push_primitive(document, doll);
    let mesh = document.root.push(Mesh {
        extensions: None,
        extras: Default::default(),
        name: Some("Mannequin".into()),
        primitives: vec![primitive],
        weights: None,
    });
    document.root.push(Node {
        name: Some("Mannequin".into()),
        mesh: Some(mesh),
        skin: Some(skin),
        ..Node::default()
    })
}

fn push_primitive(document: &mut Document, doll: &blob::Mesh) -> Primitive {
    let vertices = Some(buffer::Target::ArrayBuffer);
    let count = doll.positions.len();
    let four_bytes = |normalized| Layout {
        component: ComponentType::U8,
        kind: Type::Vec4,
        normalized,
        target: vertices,
    };
    let corners = doll.triangles.iter().flatten().flat_map(|corner| corner.to_le_bytes());
    let indices = Layout {
        component: ComponentType::U16,
        kind: Type::Scalar,
        normalized: false,
        target: Some(buffer::Target::ElementArrayBuffer),
    };
    let positions = document.vectors(&doll.positions, vertices);
    let normals = document.vectors(&doll.normals, vertices);
    let joints = doll.bones.iter().flat_map(|&bone| [bone, 0, 0, 0]);
    let joints = document.accessor(four_bytes(false), count, joints, None);
    let weights = doll.bones.iter().flat_map(|_| [u8::MAX, 0, 0, 0]);
    let weights = document.accessor(four_bytes(true), count, weights, None);
    let indices = document.accessor(indices, 3 * doll.triangles.len(), corners, None);
    let material = document.root.push(Material {
        name: Some("Mannequin".into()),
        pbr_metallic_roughness: PbrMetallicRoughness {
            base_color_factor: PbrBaseColorFactor([0.8, 0.68, 0.5, 1.0]),
            metallic_factor: StrengthFactor(0.0),
            roughness_factor: StrengthFactor(0.6),
            ..PbrMetallicRoughness::default()
        },
        ..Material::default()
    });
    let attributes: [(Checked<Semantic>, Index<Accessor>); 4] = [
        (Valid(Semantic::Positions), positions),
        (Valid(Semantic::Normals), normals),
        (Valid(Semantic::Joints(0)), joints),
        (Valid(Semantic::Weights(0)), weights),
    ];
    Primitive {
        attributes: attributes.into(),
        extensions: None,
        extras: Default::default(),
        indices: Some(indices),
        material: Some(material),
        mode: Valid(Mode::Triangles),
        targets: None,
    }
}

/// Feet stand still only where hips and legs have a key at every frame: a millimetre that a line
/// between keys is off comes and goes in a frame or two, which is centimetres a second.
fn push_animation(document: &mut Document, rig: &Rig, motion: &GeneratedMotion) {
    let feet = motion.skeleton.foot_joints();
    let motion = &motion.animation;
    let mut animation = empty_animation();
    let frames: Vec<usize> = (0..motion.root.len()).collect();
    let every = document.times(&frames, motion.fps);
    let path: Vec<_> = motion.root.iter().map(|&root| rig.place(root).as_vec3()).collect();
    let output = document.vectors(&path, None);
    push_channel(&mut animation, rig.hips(), Property::Translation, [every, output]);
    for bone in 0..rig.bones.len() {
        if rig.is_still(bone, &motion.rotations) {
            continue;
        }
        let track: Vec<DQuat> =
            motion.rotations.iter().map(|frame| rig.rotation(bone, frame)).collect();
        let keys = match rig.carries(bone, &feet) {
            true => Keys::every(&track),
            false => keys_of(rig, bone, &track),
        };
        let input = match keys.frames.len() == track.len() {
            true => every,
            false => document.times(&keys.frames, motion.fps),
        };
        let output = document.rotations(&keys.values);
        push_channel(&mut animation, bone, Property::Rotation, [input, output]);
    }
    document.root.push(animation);
}

pub(crate) fn empty_animation() -> gltf_json::Animation {
    let (extensions, extras) = (None, Default::default());
    let (channels, samplers) = (Vec::new(), Vec::new());
    animation::Animation { extensions, extras, channels, name: Some(TAKE.into()), samplers }
}

/// Reduces a track to keys. One with a time of its own takes half as many bytes again, so that
/// some tracks stay as they are.
fn keys_of(rig: &Rig, bone: usize, track: &[DQuat]) -> Keys<DQuat> {
    let keys = reduce_rotations(track, tolerance(rig, bone));
    if 3 * keys.frames.len() < 2 * track.len() { keys } else { Keys::every(track) }
}

/// Returns the largest error of a bone's rotation, radians. Bones near the root miss less, since
/// they move more: with two thirds of the power, tracks of equal curvature have the fewest keys for
/// an error at the hands.
pub(crate) fn tolerance(rig: &Rig, bone: usize) -> f64 {
    tolerance_at(rig.reach(bone))
}

/// [`tolerance`] of a bone with the farthest joint below it so many metres away.
pub(crate) fn tolerance_at(reach: f64) -> f64 {
    ROTATION_TOLERANCE.min(REACH_TOLERANCE * reach.max(1e-3).powf(-2.0 / 3.0))
}
