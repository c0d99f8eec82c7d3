//! VRM animation (`VRMC_vrm_animation` 1.0): GLB of humanoid bones for any VRM avatar.
//!
//! The nodes rest in the T-pose, the hips at their true height; rotations are local, and the hips
//! alone are moved (<https://github.com/vrm-c/vrm-specification>, VRMC_vrm_animation-1.0).

use glam::DQuat;
use gltf_json::{Index, animation::Property, extensions::root};
use serde_json::{Map, Value, json};

use crate::{
    error::FormatError,
    glb::{empty_animation, glb_bytes},
    gltf::{Document, push_channel},
    keys::Keys,
    motion::{GeneratedMotion, MotionSize},
    rig::Rig,
    target::TargetSkeleton,
};

const EXTENSION: &str = "VRMC_vrm_animation";

/// Bones without which there is no humanoid.
const REQUIRED: [&str; 15] = [
    "hips",
    "spine",
    "head",
    "leftUpperLeg",
    "leftLowerLeg",
    "leftFoot",
    "rightUpperLeg",
    "rightLowerLeg",
    "rightFoot",
    "leftUpperArm",
    "leftLowerArm",
    "leftHand",
    "rightUpperArm",
    "rightLowerArm",
    "rightHand",
];

/// About the most bytes of a motion as VRM animation.
pub(crate) fn vrma_bytes(size: MotionSize) -> usize {
    2 * glb_bytes(size)
}

/// Writes a motion as VRM animation.
///
/// # Errors
/// [`FormatError::Inconsistent`] if its parts do not fit each other or hold a NaN or an infinity,
/// [`FormatError::Skeleton`] if the model's joints are not those of SMPL.
pub fn to_vrma(motion: &GeneratedMotion) -> Result<Vec<u8>, FormatError> {
    motion.check()?;
    let target = TargetSkeleton::Vrm;
    let rig = Rig::new(&motion.skeleton, target, true)?;
    let has = |name: &&str| rig.bones.iter().any(|bone| bone.name == **name);
    if let Some(joint) = REQUIRED.iter().find(|name| !has(name)) {
        return Err(FormatError::NoBone { bone: (*joint).into(), format: "vrma" });
    }
    let mut document = Document::new(vrma_bytes(motion.size()));
    document.bones(&rig);
    document.scene(vec![Index::new(0)]);
    if !motion.animation.root.is_empty() {
        push_animation(&mut document, &rig, motion);
    }
    document.root.extensions_used.push(EXTENSION.into());
    document.root.extensions = Some(root::Root { others: extension(&rig) });
    document.into_glb()
}

/// Fingers are nodes but no humanoid bones: the motion has none, and an avatar keeps its own.
fn is_humanoid(bone: &str) -> bool {
    !bone.ends_with("MiddleProximal")
}

fn extension(rig: &Rig) -> Map<String, Value> {
    let humanoid = rig.bones.iter().enumerate().filter(|(_, bone)| is_humanoid(&bone.name));
    let bones: Map<String, Value> =
        humanoid.map(|(node, bone)| (bone.name.clone(), json!({ "node": node }))).collect();
    let content = json!({ "specVersion": "1.0", "humanoid": { "humanBones": bones } });
    [(EXTENSION.to_owned(), content)].into_iter().collect()
}

/// Every frame is a key, in floats: files of avatars are read by fewer programs than GLB, and some
/// know nothing else.
fn push_animation(document: &mut Document, rig: &Rig, motion: &GeneratedMotion) {
    let motion = &motion.animation;
    let mut animation = empty_animation();
    let frames: Vec<usize> = (0..motion.root.len()).collect();
    let input = document.times(&frames, motion.fps);
    let output = document.vectors(&motion.root, None);
    push_channel(&mut animation, rig.hips(), Property::Translation, [input, output]);
    for (bone, spec) in rig.bones.iter().enumerate() {
        if !is_humanoid(&spec.name) {
            continue;
        }
        let track: Vec<DQuat> =
            motion.rotations.iter().map(|frame| rig.rotation(bone, frame)).collect();
        let (keys, input) = match rig.is_still(bone, &motion.rotations) {
            // One key: the head must not keep another animation's pose.
            true => (Keys { frames: vec![0], values: track[..1].to_vec() }, None),
            false => (Keys::every(&track), Some(input)),
        };
        let input = input.unwrap_or_else(|| document.times(&keys.frames, motion.fps));
        let output = document.float_rotations(&keys.values);
        push_channel(&mut animation, bone, Property::Rotation, [input, output]);
    }
    document.root.push(animation);
}
