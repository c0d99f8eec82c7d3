//! A jointed doll on a skeleton: a rounded piece per bone, made from the bones' rest positions.

use bailando_motion::{STANDING_HEIGHT, Skeleton};
use glam::Vec3;

use crate::{
    blob::{Blob, Mesh},
    rig::Rig,
};

/// A piece between two joints of SMPL: which bone moves it, where it begins and ends (parts of the
/// way from the first joint to the second, then a shift in metres), half widths and depths.
struct Piece {
    bone: &'static str,
    joints: [&'static str; 2],
    span: [f32; 2],
    shift: Vec3,
    radii: [[f32; 2]; 2],
}

const fn piece(
    bone: &'static str,
    joints: [&'static str; 2],
    span: [f32; 2],
    shift: [f32; 3],
    radii: [[f32; 2]; 2],
) -> Piece {
    Piece { bone, joints, span, shift: Vec3::from_array(shift), radii }
}

/// The trunk; width is that from side to side.
const TRUNK: [Piece; 7] = [
    piece("pelvis", ["pelvis", "spine1"], [-1.0, 0.9], [0., 0., 0.01], [[0.16, 0.11], [0.14, 0.1]]),
    piece("spine1", ["spine1", "spine2"], [-0.6, 1.4], [0., 0., 0.01], [[0.13, 0.1], [0.13, 0.1]]),
    piece("spine2", ["spine2", "spine3"], [-1.2, 2.0], [0., 0., 0.01], [[0.13, 0.1], [0.15, 0.11]]),
    piece("spine3", ["spine3", "neck"], [-0.35, 1.0], [0., 0., 0.01], [[0.14, 0.1], [0.17, 0.1]]),
    piece("neck", ["neck", "head"], [-0.5, 1.4], [0., 0., 0.], [[0.055, 0.055], [0.05, 0.05]]),
    piece("head", ["neck", "head"], [0.6, 0.6], [0., 0., 0.], [[0.07, 0.08], [0.075, 0.095]]),
    piece("head", ["neck", "head"], [1.0, 1.0], [0., 0., 0.], [[0.014, 0.014], [0.008, 0.012]]),
];
/// Height of the head and of the nose, which say where it is looking, metres.
const HEAD: f32 = 0.25;

/// One side; width is that from front to back in arms, from side to side in legs.
const LIMBS: [Piece; 8] = [
    piece("collar", ["collar", "shoulder"], [-0.2, 1.1], [0.; 3], [[0.06, 0.06], [0.06, 0.06]]),
    piece("shoulder", ["shoulder", "elbow"], [-0.18, 1.1], [0.; 3], [[0.06, 0.06], [0.042, 0.042]]),
    piece("elbow", ["elbow", "wrist"], [-0.12, 1.05], [0.; 3], [[0.045, 0.045], [0.03, 0.028]]),
    piece("wrist", ["wrist", "hand"], [-0.2, 1.9], [0.; 3], [[0.04, 0.022], [0.038, 0.016]]),
    piece("hip", ["hip", "knee"], [-0.16, 1.06], [0.; 3], [[0.09, 0.09], [0.058, 0.058]]),
    piece("knee", ["knee", "ankle"], [-0.1, 1.06], [0.; 3], [[0.062, 0.062], [0.038, 0.038]]),
    piece("ankle", ["ankle", "foot"], [-0.5, 1.15], [0.; 3], [[0.04, 0.04], [0.045, 0.03]]),
    piece("foot", ["ankle", "foot"], [1.0, 1.55], [0.; 3], [[0.044, 0.03], [0.04, 0.02]]),
];

/// Makes the doll; none for a skeleton that has not the joints of SMPL.
pub(crate) fn mannequin(skeleton: &Skeleton, rig: &Rig) -> Option<Mesh> {
    let doll = Doll { skeleton, rig };
    let mut mesh = Mesh::default();
    for piece in &TRUNK {
        mesh.push(&doll.trunk(piece)?);
    }
    for side in ["l_", "r_"] {
        for piece in &LIMBS {
            mesh.push(&doll.limb(side, piece)?);
        }
    }
    Some(mesh)
}

struct Doll<'a> {
    skeleton: &'a Skeleton,
    rig: &'a Rig,
}

impl Doll<'_> {
    /// Returns the bone of a joint, and where it rests.
    fn bone(&self, joint: &str) -> Option<(usize, Vec3)> {
        let joint = self.skeleton.joints.iter().position(|name| name == joint)?;
        let bone = self.rig.bones.iter().position(|bone| bone.joint == Some(joint))?;
        Some((bone, self.rig.bones[bone].position.as_vec3()))
    }

    fn between(&self, joints: [&str; 2], span: [f32; 2]) -> Option<[Vec3; 2]> {
        let [from, to] = [self.bone(joints[0])?.1, self.bone(joints[1])?.1];
        Some(span.map(|part| from + (to - from) * part))
    }

    fn trunk(&self, piece: &Piece) -> Option<Blob> {
        let (bone, _) = self.bone(piece.bone)?;
        let [mut from, mut to] = self.between(piece.joints, piece.span)?.map(|p| p + piece.shift);
        if piece.bone == "head" {
            // The neck leans forward; the head stands upright on it, the nose in its front.
            let nose = piece.span[0] == 1.0;
            let chin = from;
            from = if nose { chin + Vec3::new(0.0, 0.3 * HEAD, 0.07) } else { chin };
            to = if nose { from + Vec3::new(0.0, -0.02, 0.04) } else { chin + Vec3::Y * HEAD };
        }
        let radii = piece.radii;
        Some(Blob { bone, from, to, side: Vec3::X, radii })
    }

    fn limb(&self, side: &str, piece: &Piece) -> Option<Blob> {
        let named = |joint: &str| format!("{side}{joint}");
        let (bone, _) = self.bone(&named(piece.bone))?;
        let joints = piece.joints.map(named);
        let joints = [joints[0].as_str(), joints[1].as_str()];
        let [mut from, mut to] = self.between(joints, piece.span)?;
        let is_arm = matches!(piece.bone, "collar" | "shoulder" | "elbow" | "wrist");
        if matches!(piece.bone, "ankle" | "foot") {
            // Soles are on the floor where a standing foot's are.
            let floor = self.bone(joints[1])?.1.y - STANDING_HEIGHT;
            let ahead = (to - from).with_y(0.0);
            if piece.bone == "foot" {
                from.y = floor + 0.5 * piece.radii[0][1] + 0.012;
                to = (from + ahead).with_y(floor + piece.radii[1][1]);
            } else {
                from.y = floor + 0.045;
                to.y = floor + piece.radii[1][1];
            }
        }
        let side = if is_arm { Vec3::Z } else { Vec3::X };
        Some(Blob { bone, from, to, side, radii: piece.radii })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::target::TargetSkeleton;

    #[test]
    fn it_stands_on_the_floor_and_has_the_size_of_a_person() {
        let json = include_str!("../../../tests/fixtures/motion/skeleton.json");
        let skeleton: Skeleton = serde_json::from_str(json).unwrap();
        for target in TargetSkeleton::ALL {
            let rig = Rig::new(&skeleton, target, true).unwrap();
            let mesh = mannequin(&skeleton, &rig).unwrap();
            assert!(mesh.positions.len() < 3000 && mesh.triangles.len() < 6000);
            let heights = mesh.positions.iter().map(|p| p.y);
            let lowest = heights.clone().fold(f32::INFINITY, f32::min);
            let highest = heights.fold(f32::NEG_INFINITY, f32::max);
            assert!((-0.005..0.01).contains(&lowest), "{target:?}: {lowest}");
            assert!((1.5..1.9).contains(&highest), "{target:?}: {highest}");
            assert!(mesh.bones.iter().all(|&bone| usize::from(bone) < rig.bones.len()));
        }
    }

    #[test]
    fn a_skeleton_of_other_joints_has_none() {
        let skeleton = Skeleton {
            joints: vec!["pelvis".into()],
            parents: vec![-1],
            offsets: vec![[0.0; 3]],
            root_height: 0.9,
        };
        let rig = Rig::new(&skeleton, TargetSkeleton::Smpl, true).unwrap();
        assert!(mannequin(&skeleton, &rig).is_none());
    }
}
