//! A limb of two bones with a hinge between them: arm or leg.

use glam::{DMat3, DQuat, DVec3, Quat};

use super::pose::WorldPose;
use crate::{
    inverse::SHORTEST_BONE,
    skeleton::Skeleton,
    two_bones::{TwoBones, perpendicular},
};

/// A chain of three joints and the bone that hangs on it: shoulder, elbow, wrist and hand, or hip,
/// knee, ankle and foot.
#[derive(Clone, Debug)]
pub(crate) struct Limb {
    pub(crate) joints: [usize; 4],
    pub(crate) bones: TwoBones,
    /// Unit vectors along the upper, the lower and the last bone in the rest pose.
    rest: [DVec3; 3],
    /// Axis about which the lower bone flexes, at right angles to the upper bone in the rest pose.
    hinge: DVec3,
}

impl Limb {
    /// Finds the limb above its last joint, which flexes towards `flexed` from the rest pose; none
    /// where there are no three bones.
    pub(crate) fn above(skeleton: &Skeleton, last: usize, flexed: DVec3) -> Option<Self> {
        let end = skeleton.parent(last)?;
        let middle = skeleton.parent(end)?;
        let upper = skeleton.parent(middle)?;
        skeleton.parent(upper)?;
        let joints = [upper, middle, end, last];
        let bones = [middle, end, last].map(|joint| skeleton.offset(joint).as_dvec3());
        let rest = bones.map(DVec3::normalize_or_zero);
        let hinge = rest[0].cross(flexed).try_normalize()?;
        let long_enough = bones.iter().all(|bone| bone.length() > SHORTEST_BONE);
        let bones = TwoBones { thigh: bones[0].length(), shank: bones[1].length() };
        long_enough.then_some(Self { joints, bones, rest, hinge })
    }

    /// Returns the axis of the hinge for a world rotation of the upper bone.
    pub(crate) fn axis(&self, upper: DQuat) -> DVec3 {
        upper * self.hinge
    }

    /// Returns the direction of a bone (0 to 2) for a world rotation of it.
    pub(crate) fn direction(&self, bone: usize, turn: DQuat) -> DVec3 {
        turn * self.rest[bone]
    }

    /// Returns the smallest rotation from `turn` of a bone (0 to 2) that points it to `direction`.
    pub(crate) fn pointed(&self, bone: usize, turn: DQuat, direction: DVec3) -> DQuat {
        (DQuat::from_rotation_arc(turn * self.rest[bone], direction) * turn).normalize()
    }

    /// Returns the world rotations of the two bones that put the end of the limb at `line` metres
    /// from its upper joint, flexed about `axis`. A line longer or shorter than the bones allow is
    /// met in direction alone.
    pub(crate) fn reach(&self, line: DVec3, axis: DVec3) -> [DQuat; 2] {
        let along = line.normalize_or(DVec3::NEG_Y);
        let axis = perpendicular(axis, along)
            .try_normalize()
            .unwrap_or_else(|| along.any_orthonormal_vector());
        let (off, from_upper) = self.bones.knee(line.length());
        let middle = along * from_upper + along.cross(axis) * off;
        let upper = middle.normalize_or(along);
        let lower = (line - middle).normalize_or(along);
        let frame = |bone: DVec3, axis: DVec3| DMat3::from_cols(bone, axis, bone.cross(axis));
        let turn = frame(upper, axis) * frame(self.rest[0], self.hinge).transpose();
        let turn = DQuat::from_mat3(&turn).normalize();
        [turn, self.pointed(1, turn, lower)]
    }

    /// Writes the world rotations of the limb's three joints as local ones.
    pub(crate) fn write(&self, pose: &WorldPose, turns: [DQuat; 3], rotations: &mut [Quat]) {
        let mut above = pose.turn_above(self.joints[0]);
        for (&joint, turn) in self.joints.iter().zip(turns) {
            rotations[joint] = (above.inverse() * turn).as_quat().normalize();
            above = turn;
        }
    }

    /// Returns the distance from upper joint to end at which the hinge is bent by `angle` radians.
    pub(crate) fn distance_at(&self, angle: f64) -> f64 {
        let TwoBones { thigh, shank } = self.bones;
        (thigh * thigh + shank * shank + 2.0 * thigh * shank * angle.cos()).max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_bends_about_its_hinge_and_reaches_its_target() {
        let skeleton = Skeleton::fixture();
        for (last, flexed) in
            [(22, DVec3::Z), (23, DVec3::Z), (10, DVec3::NEG_Z), (11, DVec3::NEG_Z)]
        {
            let limb = Limb::above(&skeleton, last, flexed).unwrap();
            let axis = DVec3::new(0.3, -0.8, 0.5).normalize();
            for angle in [0.4, 1.0, 2.0, 2.6] {
                let line = perpendicular(DVec3::new(0.2, -0.9, 0.3), axis).normalize()
                    * limb.distance_at(angle);
                let [upper, lower] = limb.reach(line, axis);
                let [first, second] = [limb.direction(0, upper), limb.direction(1, lower)];
                let end = first * limb.bones.thigh + second * limb.bones.shank;
                assert!((end - line).length() < 1e-9);
                assert!((limb.axis(upper) - axis).length() < 1e-9);
                // Flexion turns the upper bone's direction about the axis to the lower bone's.
                let turned = first.cross(second);
                assert!((turned.dot(axis) - angle.sin()).abs() < 1e-9, "{angle}");
            }
        }
    }

    #[test]
    fn the_rest_pose_flexes_forearms_forwards_and_shanks_backwards() {
        let skeleton = Skeleton::fixture();
        for (last, flexed) in [(22, DVec3::Z), (11, DVec3::NEG_Z)] {
            let limb = Limb::above(&skeleton, last, flexed).unwrap();
            let bent = DQuat::from_axis_angle(limb.axis(DQuat::IDENTITY), 1.2);
            assert!((bent * limb.rest[1]).dot(flexed) > 0.7);
        }
    }
}
