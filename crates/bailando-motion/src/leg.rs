//! One leg of fixed bone lengths, bent so that its foot is where the decoder has it.

use glam::{DQuat, DVec3};
use ndarray::ArrayView2;

use crate::{
    animation::{Animation, Positions, position},
    fit::{nearer_sign, smallest_rotation},
    inverse::{SHORTEST_BONE, TWIST_RATE},
    skeleton::Skeleton,
    two_bones::{TwoBones, perpendicular},
};

/// A foot this close to its target is left alone, metres: what single precision makes of a motion
/// that has the skeleton's lengths.
const ALREADY_THERE: f64 = 1e-5;
/// Fastest turn of a knee about the line from hip to ankle where all of its bend is this leg's own,
/// radians a second; a fast spin. Decoders turn a dancer round by folding hips through each other.
const KNEE_RATE: f64 = 12.0;

/// A chain of hip, knee, ankle and foot with one child each.
#[derive(Clone, Debug)]
pub(crate) struct Leg {
    /// Joints from the root down to the hip's parent, with their offsets.
    above: Vec<(usize, DVec3)>,
    /// Hip, knee, ankle and foot.
    pub(crate) joints: [usize; 4],
    /// Offsets of the four from their parents.
    offsets: [DVec3; 4],
    bones: TwoBones,
}

/// The pose that a leg of the skeleton has to take in one frame.
struct Target {
    /// World rotation of the hip's parent.
    above: DQuat,
    hip: DVec3,
    ankle: DVec3,
    foot: DVec3,
    /// Share of its own length to which the decoder's leg is extended.
    extension: f64,
    /// The decoder's knee relative to its line from hip to ankle, turned onto this leg's line.
    bend: DVec3,
    /// Unit vector from hip to ankle.
    axis: DVec3,
    distance: f64,
}

/// A leg's rotations (hip, knee, ankle) and the unit vector to the knee's side in one frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LegPose {
    rotations: [DQuat; 3],
    side: DVec3,
}

impl Leg {
    /// Finds the leg above a foot; `None` if the joints above it are no leg.
    pub(crate) fn above_foot(skeleton: &Skeleton, foot: usize) -> Option<Self> {
        let ankle = skeleton.parent(foot)?;
        let knee = skeleton.parent(ankle)?;
        let hip = skeleton.parent(knee)?;
        let offset = |joint: usize| skeleton.offset(joint).as_dvec3();
        let ancestors = std::iter::successors(skeleton.parent(hip), |&j| skeleton.parent(j));
        let mut above: Vec<_> = ancestors.map(|joint| (joint, offset(joint))).collect();
        above.reverse();
        let joints = [hip, knee, ankle, foot];
        let offsets = joints.map(offset);
        let [_, thigh, shank, sole] = offsets.map(DVec3::length);
        let children = |joint: usize| {
            let parents = (0..skeleton.joints.len()).map(|child| skeleton.parent(child));
            parents.filter(|&parent| parent == Some(joint)).count()
        };
        let is_leg = !above.is_empty()
            && joints[..3].iter().all(|&joint| children(joint) == 1)
            && [thigh, shank, sole].iter().all(|&l| l > SHORTEST_BONE);
        is_leg.then_some(Self { above, joints, offsets, bones: TwoBones { thigh, shank } })
    }

    /// Returns the height of the decoder's foot, metres.
    pub(crate) fn foot_height(&self, pose: ArrayView2<'_, f32>) -> f64 {
        pose[[self.joints[3], 1]].into()
    }

    /// Returns how much lower the root must be for the foot to reach its target, metres.
    pub(crate) fn missing_reach(
        &self,
        animation: &Animation,
        frame: usize,
        pose: ArrayView2<'_, f32>,
    ) -> f64 {
        let target = self.target(animation, frame, pose);
        let reached = self.bones.reach(target.distance, target.extension);
        // A root lowered by one metre comes nearer by the axis' fall.
        (target.distance - reached).max(0.0) / (-target.axis.y).max(0.5)
    }

    /// Bends the leg in every frame of an animation to the decoder's foot; `last` is its pose in
    /// the frame before.
    pub(crate) fn bend(
        &self,
        animation: &mut Animation,
        decoded: &Positions,
        last: &mut Option<LegPose>,
    ) {
        let seconds = 1.0 / f64::from(animation.fps.max(1));
        for (frame, pose) in decoded.outer_iter().enumerate() {
            let target = self.target(animation, frame, pose);
            let local = &mut animation.rotations[frame];
            let solved = [0, 1, 2].map(|i| local[self.joints[i]].as_dquat().normalize());
            let before = last.map(|last| last.rotations);
            let side = self.knee_side(&target, last.map(|last| last.side), KNEE_RATE * seconds);
            let mut rotations = if self.meets(&target, solved) {
                solved
            } else {
                self.rotations(&target, side, before, solved, TWIST_RATE * seconds)
            };
            if let Some(before) = before {
                rotations = [0, 1, 2].map(|i| nearer_sign(rotations[i], before[i]));
            }
            for (&joint, rotation) in self.joints.iter().zip(rotations) {
                local[joint] = rotation.as_quat().normalize();
            }
            *last = Some(LegPose { rotations, side });
        }
    }

    fn target(&self, animation: &Animation, frame: usize, pose: ArrayView2<'_, f32>) -> Target {
        let mut above = DQuat::IDENTITY;
        let mut at = animation.root[frame].as_dvec3();
        for (index, &(joint, offset)) in self.above.iter().enumerate() {
            if index > 0 {
                at += above * offset;
            }
            above = (above * animation.rotations[frame][joint].as_dquat()).normalize();
        }
        let hip = at + above * self.offsets[0];
        let [own_hip, own_knee, own_ankle, foot] =
            self.joints.map(|joint| position(pose.row(joint)));
        // The foot is what stands on the floor, so it is the foot that is met: the ankle lies
        // above it by the skeleton's length in the decoder's direction.
        let sole = foot - own_ankle;
        let ankle = match sole.try_normalize() {
            Some(towards) if sole.length() > SHORTEST_BONE => {
                foot - towards * self.offsets[3].length()
            }
            _ => own_ankle,
        };
        let down = above * DVec3::NEG_Y;
        let (line, own_line) = (ankle - hip, own_ankle - own_hip);
        let axis = line.try_normalize().unwrap_or(down);
        let own_axis = own_line.try_normalize().unwrap_or(axis);
        let own_length = (own_knee - own_hip).length() + (own_ankle - own_knee).length();
        let bend = perpendicular(own_knee - own_hip, own_axis);
        Target {
            above,
            hip,
            ankle,
            foot,
            extension: own_line.length() / own_length.max(SHORTEST_BONE),
            bend: DQuat::from_rotation_arc(own_axis, axis) * bend,
            axis,
            distance: line.length(),
        }
    }

    /// Whether local rotations bring this leg's ankle and foot to their targets.
    fn meets(&self, target: &Target, [hip, knee, ankle]: [DQuat; 3]) -> bool {
        let [_, thigh, shank, sole] = self.offsets;
        let hip = target.above * hip;
        let knee = hip * knee;
        let at_ankle = target.hip + hip * thigh + knee * shank;
        let at_foot = at_ankle + knee * ankle * sole;
        (at_ankle - target.ankle).length() < ALREADY_THERE
            && (at_foot - target.foot).length() < ALREADY_THERE
    }

    /// Returns the unit vector from the line hip to ankle to the knee: the decoder's, and as far as
    /// this leg must bend more than that, the front. The leg's own part turns by at most `max_turn`
    /// radians.
    fn knee_side(&self, target: &Target, before: Option<DVec3>, max_turn: f64) -> DVec3 {
        let distance = self.bones.reach(target.distance, target.extension);
        let (off, _) = self.bones.knee(distance);
        let more = (off - target.bend.length()).max(0.0);
        let side = perpendicular(target.bend + more * self.front(target), target.axis);
        let carried = before.and_then(|side| perpendicular(side, target.axis).try_normalize());
        let side = match side.try_normalize() {
            Some(unit) if side.length() > SHORTEST_BONE => unit,
            _ => return carried.unwrap_or_else(|| target.axis.any_orthonormal_vector()),
        };
        let Some(carried) = carried else {
            return side;
        };
        let angle = carried.cross(side).dot(target.axis).atan2(carried.dot(side));
        // A leg of the decoder's lengths copies its knee, however fast that turns.
        let permitted = max_turn * off / more.max(SHORTEST_BONE);
        if angle.abs() <= permitted {
            return side;
        }
        DQuat::from_axis_angle(target.axis, angle.clamp(-permitted, permitted)) * carried
    }

    /// Returns the rest pose's front (+z), swung with the leg without twist.
    fn front(&self, target: &Target) -> DVec3 {
        let rest = (self.offsets[1] + self.offsets[2]).normalize_or(DVec3::NEG_Y);
        let swung = DQuat::from_rotation_arc(rest, target.above.inverse() * target.axis);
        target.above * swung * perpendicular(DVec3::Z, rest).normalize_or_zero()
    }

    /// Returns the smallest local rotations of hip, knee and ankle that take the leg to its target.
    fn rotations(
        &self,
        target: &Target,
        side: DVec3,
        before: Option<[DQuat; 3]>,
        solved: [DQuat; 3],
        max_twist: f64,
    ) -> [DQuat; 3] {
        let distance = self.bones.reach(target.distance, target.extension);
        let (off, along) = self.bones.knee(distance);
        let knee = target.axis * along + side * off;
        let ankle = target.axis * distance;
        let sole = target.foot - target.ankle;
        let mut above = target.above;
        let mut rotations = solved;
        for (joint, bone) in [knee, ankle - knee, sole].into_iter().enumerate() {
            let rest = self.offsets[joint + 1].try_normalize();
            if let (Some(rest), Some(bone)) = (rest, (above.inverse() * bone).try_normalize()) {
                let before = before.map(|before| before[joint]);
                rotations[joint] = smallest_rotation(rest, bone, before, max_twist);
            }
            above = (above * rotations[joint]).normalize();
        }
        rotations
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_knee_that_is_not_the_decoders_turns_no_faster_than_a_spin() {
        let leg = Leg::above_foot(&Skeleton::fixture(), 10).unwrap();
        let target = |above: DQuat| Target {
            above,
            hip: DVec3::Y,
            ankle: DVec3::Y * 0.4,
            foot: DVec3::new(0.0, 0.35, 0.1),
            extension: 1.0,
            bend: DVec3::ZERO,
            axis: DVec3::NEG_Y,
            distance: 0.6,
        };
        let ahead = leg.knee_side(&target(DQuat::IDENTITY), None, 0.2);
        assert!(ahead.z > 0.99);
        let half_turn = target(DQuat::from_rotation_y(3.0));
        let next = leg.knee_side(&half_turn, Some(ahead), 0.2);
        assert!((next.angle_between(ahead) - 0.2).abs() < 1e-9);
        // A knee of the decoder's own bend is copied at once.
        let copied = Target { bend: DVec3::NEG_Z * leg.bones.knee(0.6).0, ..half_turn };
        assert!(leg.knee_side(&copied, Some(ahead), 0.2).z < -0.99);
    }
}
