//! VMD: motion of MikuMikuDance, on the bones that its models share.
//!
//! 30 frames a second; left-handed, y up, models face -z; rotations are local, with axes parallel
//! to the world's, from an A-pose. Legs are turned directly, so their inverse kinematics is
//! switched off. Names are Shift-JIS in fields of fixed size.

use bailando_motion::{Animation, resample};
use encoding_rs::SHIFT_JIS;
use glam::{DQuat, DVec3, Quat};

use crate::{
    error::FormatError,
    glb::tolerance,
    keys::reduce_rotations,
    motion::{GeneratedMotion, MotionSize},
    rig::{Rig, t_pose},
};

/// Frames per second of every VMD.
const FPS: u32 = 30;
/// Units per metre: a model of 158 cm is 20 units tall.
const UNITS: f64 = 12.5;
/// Arms hang so far below the horizontal in the rest pose of customary models, degrees.
const ARM_ANGLE: f64 = 35.0;
const MODEL_NAME: usize = 20;
const BONE_NAME: usize = 15;
const IK_NAME: usize = 20;
/// Bytes of a key: name, frame, position, rotation, interpolation.
const KEY_BYTES: usize = BONE_NAME + 4 + 12 + 16 + INTERPOLATION;
/// Bytes of the interpolation curves of a key.
const INTERPOLATION: usize = 64;

/// A bone and the joints whose rotations it takes, from the body outward.
const BONES: [(&str, &[&str]); 19] = [
    ("センター", &["pelvis"]),
    ("上半身", &["spine1", "spine2"]),
    ("上半身2", &["spine3"]),
    ("首", &["neck"]),
    ("頭", &["head"]),
    ("左肩", &["l_collar"]),
    ("左腕", &["l_shoulder"]),
    ("左ひじ", &["l_elbow"]),
    ("左手首", &["l_wrist"]),
    ("右肩", &["r_collar"]),
    ("右腕", &["r_shoulder"]),
    ("右ひじ", &["r_elbow"]),
    ("右手首", &["r_wrist"]),
    ("左足", &["l_hip"]),
    ("左ひざ", &["l_knee"]),
    ("左足首", &["l_ankle"]),
    ("右足", &["r_hip"]),
    ("右ひざ", &["r_knee"]),
    ("右足首", &["r_ankle"]),
];
/// Inverse kinematics that is off.
const IK: [&str; 4] = ["左足ＩＫ", "右足ＩＫ", "左つま先ＩＫ", "右つま先ＩＫ"];

/// About the most bytes of a motion as VMD.
pub(crate) fn vmd_bytes(size: MotionSize) -> usize {
    let frames = 2 + size.frames * FPS as usize / size.fps.max(1) as usize;
    1024 + BONES.len() * KEY_BYTES * frames
}

/// Writes a motion as VMD, at 30 frames a second.
///
/// # Errors
/// [`FormatError::Inconsistent`] if its parts do not fit each other or hold a NaN or an infinity,
/// [`FormatError::NoBone`] if the model's joints are not those of SMPL.
pub fn to_vmd(motion: &GeneratedMotion) -> Result<Vec<u8>, FormatError> {
    motion.check()?;
    let rig = Rig::posed(&motion.skeleton, a_pose, &|_, _| DQuat::IDENTITY);
    let resampled;
    let animation = if motion.animation.fps == FPS {
        &motion.animation
    } else {
        resampled = resample(&motion.animation, FPS)?;
        &resampled
    };
    let mut file = Vec::with_capacity(vmd_bytes(motion.size()));
    push_text(&mut file, "Vocaloid Motion Data 0002", 30);
    push_text(&mut file, "Bailando", MODEL_NAME);
    push_bones(&mut file, &rig, animation)?;
    // Faces, cameras, lights and shadows: none.
    file.extend([0; 4 * 4]);
    push_ik(&mut file);
    Ok(file)
}

/// The rest pose of models: the T-pose with hanging arms.
fn a_pose(joint: &str, bone: DVec3) -> Option<DVec3> {
    let hanging = |arm: DVec3| {
        let is_arm =
            joint.ends_with("shoulder") || joint.ends_with("elbow") || joint.ends_with("wrist");
        let angle = -ARM_ANGLE.to_radians() * arm.x.signum();
        if is_arm { DQuat::from_rotation_z(angle) * arm } else { arm }
    };
    t_pose(joint, bone).map(hanging)
}

fn push_bones(file: &mut Vec<u8>, rig: &Rig, animation: &Animation) -> Result<(), FormatError> {
    let count = file.len();
    file.extend([0; 4]);
    let mut keys: u32 = 0;
    for (name, joints) in BONES {
        let mut field = Vec::with_capacity(BONE_NAME);
        push_text(&mut field, name, BONE_NAME);
        let bones: Vec<usize> =
            joints.iter().map(|joint| find(rig, joint)).collect::<Result<_, _>>()?;
        let track: Vec<DQuat> =
            animation.rotations.iter().map(|frame| product(rig, &bones, frame)).collect();
        // The centre has a place at every frame, so that a rotation there costs nothing.
        if bones == [rig.hips()] {
            let rest = rig.bones[rig.hips()].position;
            for (frame, (root, turn)) in animation.root.iter().zip(track).enumerate() {
                push_key(file, &field, frame, (root.as_dvec3() - rest) * UNITS, turn);
                keys += 1;
            }
        } else {
            let reduced = reduce_rotations(&track, tolerance(rig, bones[bones.len() - 1]));
            for (frame, turn) in reduced.frames.into_iter().zip(reduced.values) {
                push_key(file, &field, frame, DVec3::ZERO, turn);
                keys += 1;
            }
        }
    }
    file[count..count + 4].copy_from_slice(&keys.to_le_bytes());
    Ok(())
}

fn find(rig: &Rig, joint: &str) -> Result<usize, FormatError> {
    let bone = rig.bones.iter().position(|bone| bone.name == joint);
    bone.ok_or_else(|| FormatError::NoBone { bone: joint.into(), format: "vmd" })
}

fn product(rig: &Rig, bones: &[usize], frame: &[Quat]) -> DQuat {
    bones.iter().fold(DQuat::IDENTITY, |turn, &bone| turn * rig.rotation(bone, frame))
}

fn push_key(file: &mut Vec<u8>, bone: &[u8], frame: usize, place: DVec3, turn: DQuat) {
    file.extend(bone);
    file.extend((frame as u32).to_le_bytes());
    // Left-handed: z is mirrored.
    let numbers = [place.x, place.y, -place.z, -turn.x, -turn.y, turn.z, turn.w];
    for number in numbers {
        file.extend((number as f32).to_le_bytes());
    }
    file.extend(linear());
}

/// Straight interpolation of x, y, z and the rotation, as MikuMikuDance writes it: four rows, each
/// shifted by one byte against the last.
fn linear() -> [u8; INTERPOLATION] {
    const CURVE: [u8; 16] =
        [20, 20, 20, 20, 20, 20, 20, 20, 107, 107, 107, 107, 107, 107, 107, 107];
    let mut bytes = [0; INTERPOLATION];
    for (row, bytes) in bytes.chunks_exact_mut(CURVE.len()).enumerate() {
        let shifted = CURVE.iter().skip(row);
        for (byte, curve) in bytes.iter_mut().zip(shifted) {
            *byte = *curve;
        }
    }
    bytes
}

/// Says, for the whole motion, that the model is shown and which inverse kinematics is off.
fn push_ik(file: &mut Vec<u8>) {
    file.extend(1_u32.to_le_bytes());
    file.extend(0_u32.to_le_bytes());
    file.push(1);
    file.extend((IK.len() as u32).to_le_bytes());
    for name in IK {
        push_text(file, name, IK_NAME);
        file.push(0);
    }
}

/// Appends a text in Shift-JIS, filled up with zeros to its field.
fn push_text(file: &mut Vec<u8>, text: &str, field: usize) {
    let (bytes, _, _) = SHIFT_JIS.encode(text);
    let start = file.len();
    file.extend(bytes.iter().take(field));
    file.resize(start + field, 0);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_fits_its_field() {
        let fits = |name: &str, field: usize| {
            let (bytes, _, failed) = SHIFT_JIS.encode(name);
            assert!(!failed && bytes.len() <= field, "{name}");
        };
        BONES.iter().for_each(|(name, _)| fits(name, BONE_NAME));
        IK.iter().for_each(|name| fits(name, IK_NAME));
    }
}
