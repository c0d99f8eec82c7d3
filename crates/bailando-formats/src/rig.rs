//! A motion's skeleton as bones of a target: rest pose, axes, and the rotations on them.
//!
//! A bone's world rotation is its joint's times a constant `turn`, which takes the target's rest
//! axes in the target's rest pose to the joint's rest. With it every joint is where forward
//! kinematics puts it, whatever the target's rest pose.

use bailando_motion::{STANDING_HEIGHT, Skeleton};
use glam::{DQuat, DVec3, Quat, Vec3};

use crate::{error::FormatError, target::TargetSkeleton};

/// Bones shorter than this, in metres, have no direction.
const SHORTEST_BONE: f64 = 1e-6;
/// Length of the end of a bone that has none, metres.
const SHORTEST_END: f32 = 0.05;

/// Bones of a target, a parent before its children.
#[derive(Clone, Debug)]
pub(crate) struct Rig {
    pub(crate) bones: Vec<Bone>,
}

#[derive(Clone, Debug)]
pub(crate) struct Bone {
    pub(crate) name: String,
    pub(crate) parent: Option<usize>,
    /// The motion's joint that it is; none for a bone that stands on the floor.
    pub(crate) joint: Option<usize>,
    /// From the parent, in its rest axes, metres; for the first joint, its rest position with
    /// the feet on the floor.
    pub(crate) offset: DVec3,
    /// Rest rotation in the parent's rest axes.
    pub(crate) rest: DQuat,
    /// Rest position and rotation in the world.
    pub(crate) position: DVec3,
    pub(crate) axes: DQuat,
    turn: DQuat,
}

/// Where the bones of a joint point in a target's rest pose; none: where the joint's does.
pub(crate) type RestPose = fn(joint: &str, bone: DVec3) -> Option<DVec3>;

/// The T-pose: arms to the sides, legs straight down, feet straight ahead.
pub(crate) fn t_pose(joint: &str, bone: DVec3) -> Option<DVec3> {
    match joint {
        "l_hip" | "r_hip" | "l_knee" | "r_knee" => Some(DVec3::NEG_Y),
        "l_ankle" | "r_ankle" => Some(DVec3::new(0.0, bone.y, bone.x.hypot(bone.z)).normalize()),
        "l_shoulder" | "l_elbow" | "l_wrist" => Some(DVec3::X),
        "r_shoulder" | "r_elbow" | "r_wrist" => Some(DVec3::NEG_X),
        _ => None,
    }
}

/// The rest pose of the motion's own skeleton.
fn own_pose(_: &str, _: DVec3) -> Option<DVec3> {
    None
}

impl Rig {
    /// Plans the bones of `target`; with axes parallel to the world's where the format cannot hold
    /// others.
    ///
    /// # Errors
    /// [`FormatError::Skeleton`] if the skeleton has joints that the target does not know.
    pub(crate) fn new(
        skeleton: &Skeleton,
        target: TargetSkeleton,
        own_axes: bool,
    ) -> Result<Self, FormatError> {
        let pose = if target == TargetSkeleton::Smpl { own_pose } else { t_pose as RestPose };
        let axes = |joint: &str, direction| match own_axes {
            true => target.axes(joint, direction),
            false => DQuat::IDENTITY,
        };
        let mut rig = Self::posed(skeleton, pose, &axes);
        for bone in &mut rig.bones {
            bone.name = target.bone_name(&bone.name).ok_or_else(|| FormatError::Skeleton {
                joint: bone.name.clone(),
                target: target.name(),
            })?;
        }
        if let Some((name, axes)) = target.floor_bone() {
            rig.stand_on(name, if own_axes { axes } else { DQuat::IDENTITY });
        }
        Ok(rig)
    }

    /// Plans bones named after their joints, in this rest pose and with these axes.
    pub(crate) fn posed(
        skeleton: &Skeleton,
        pose: RestPose,
        axes: &dyn Fn(&str, DVec3) -> DQuat,
    ) -> Self {
        let mut rig = Self { bones: Vec::with_capacity(skeleton.joints.len()) };
        let mut corrections: Vec<DQuat> = Vec::with_capacity(skeleton.joints.len());
        for (joint, name) in skeleton.joints.iter().enumerate() {
            let parent = skeleton.parent(joint);
            let bone = bone_of(skeleton, joint);
            let direction = bone.normalize();
            let is_leaf = children(skeleton, joint).next().is_none();
            // From the target's rest pose to the joint's.
            let correction = match (pose(name, bone), parent) {
                (Some(rest), _) => DQuat::from_rotation_arc(rest, direction),
                (None, Some(parent)) if is_leaf => corrections[parent],
                (None, _) => DQuat::IDENTITY,
            };
            let axes = axes(name, correction.inverse() * direction);
            let above = parent.and_then(|parent| rig.bones.get(parent));
            let offset = skeleton.offset(joint).as_dvec3();
            let (offset, rest, position) = match above {
                None => (DVec3::ZERO, axes, DVec3::ZERO),
                Some(above) => {
                    let offset = above.turn.inverse() * offset;
                    let position = above.position + above.axes * offset;
                    (offset, above.axes.inverse() * axes, position)
                }
            };
            let turn = (correction * axes).normalize();
            corrections.push(correction);
            let (name, joint) = (name.clone(), Some(joint));
            rig.bones.push(Bone { name, parent, joint, offset, rest, position, axes, turn });
        }
        rig.put_feet_on_floor();
        rig
    }

    fn put_feet_on_floor(&mut self) {
        let lowest = self.bones.iter().map(|bone| bone.position.y).fold(0.0, f64::min);
        let lift = if lowest < 0.0 { f64::from(STANDING_HEIGHT) - lowest } else { 0.0 };
        for bone in &mut self.bones {
            bone.position.y += lift;
        }
        if let Some(root) = self.bones.first_mut() {
            root.offset = root.position;
        }
    }

    /// Puts a bone at the origin above all others.
    fn stand_on(&mut self, name: &str, axes: DQuat) {
        for bone in &mut self.bones {
            bone.parent = Some(bone.parent.map_or(0, |parent| parent + 1));
        }
        if let Some(hips) = self.bones.first_mut() {
            hips.offset = axes.inverse() * hips.offset;
            hips.rest = axes.inverse() * hips.rest;
        }
        let (name, zero) = (name.to_owned(), DVec3::ZERO);
        let floor = Bone {
            name,
            parent: None,
            joint: None,
            offset: zero,
            rest: axes,
            position: zero,
            axes,
            turn: axes,
        };
        self.bones.insert(0, floor);
    }

    /// Returns a place of the motion's first joint in the axes above it.
    pub(crate) fn place(&self, root: Vec3) -> DVec3 {
        let above = self.bones[self.hips()].parent;
        let turn = above.map_or(DQuat::IDENTITY, |parent| self.bones[parent].turn);
        turn.inverse() * root.as_dvec3()
    }

    /// Returns the bone of the motion's first joint, which carries its path.
    pub(crate) fn hips(&self) -> usize {
        self.bones.iter().position(|bone| bone.joint == Some(0)).unwrap_or_default()
    }

    /// Returns the bones below `bone`, in their order.
    pub(crate) fn children(&self, bone: usize) -> impl Iterator<Item = usize> + '_ {
        let below = self.bones.iter().enumerate();
        below.filter(move |(_, other)| other.parent == Some(bone)).map(|(index, _)| index)
    }

    /// Returns the end of a leaf's bone, in its rest axes. The last bone continues by its own
    /// length, so that programs which draw bones from joint to joint show hands and head; toes
    /// continue along the floor.
    pub(crate) fn end(&self, bone: usize, skeleton: &Skeleton) -> DVec3 {
        let Bone { joint, turn, .. } = &self.bones[bone];
        let offset = joint.map_or(Vec3::ZERO, |joint| skeleton.offset(joint));
        let on_floor = joint.is_some_and(|joint| skeleton.foot_joints().contains(&joint));
        let end = if on_floor { 0.5 * offset.with_y(0.0) } else { offset };
        // Too short to be drawn, or none at all (a lone root).
        let end = if end.length() < 1e-3 { Vec3::Y * SHORTEST_END } else { end };
        turn.inverse() * end.as_dvec3()
    }

    /// Returns the largest distance of a bone from any below it in the rest pose, metres.
    pub(crate) fn reach(&self, bone: usize) -> f64 {
        let below = |child: usize| self.bones[child].offset.length() + self.reach(child);
        self.children(bone).map(below).fold(0.0, f64::max)
    }

    /// Whether one of these joints of the motion hangs on a bone.
    pub(crate) fn carries(&self, bone: usize, joints: &[usize]) -> bool {
        let is_one =
            |child: usize| self.bones[child].joint.is_some_and(|own| joints.contains(&own));
        self.children(bone).any(|child| is_one(child) || self.carries(child, joints))
    }

    /// Returns a bone's local rotation in a frame of the motion's local rotations.
    pub(crate) fn rotation(&self, bone: usize, frame: &[Quat]) -> DQuat {
        let Bone { parent, joint, turn, .. } = &self.bones[bone];
        let above = parent.map_or(DQuat::IDENTITY, |parent| self.bones[parent].turn);
        let own = joint.map_or(DQuat::IDENTITY, |joint| frame[joint].as_dquat());
        (above.inverse() * own * *turn).normalize()
    }

    /// Whether a bone never leaves its rest rotation in this motion.
    pub(crate) fn is_still(&self, bone: usize, frames: &[Vec<Quat>]) -> bool {
        let Some(joint) = self.bones[bone].joint else { return true };
        let rest = self.bones[bone].rest;
        let at_rest = |frame: &Vec<Quat>| self.rotation(bone, frame).dot(rest).abs() > 1.0 - 1e-13;
        frames.iter().all(|frame| frame[joint] == Quat::IDENTITY && at_rest(frame))
    }

    /// Returns the nearest axis of a bone to each axis of the world in the rest pose.
    pub(crate) fn nearest_axes(&self, bone: usize) -> [usize; 3] {
        let into_bone = self.bones[bone].axes.inverse();
        [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| (into_bone * axis).abs().max_position())
    }
}

fn children(skeleton: &Skeleton, joint: usize) -> impl Iterator<Item = usize> + '_ {
    (joint + 1..skeleton.joints.len()).filter(move |&child| skeleton.parent(child) == Some(joint))
}

/// Returns the bone of a joint: to its only child, else on along its parent's.
fn bone_of(skeleton: &Skeleton, joint: usize) -> DVec3 {
    let mut below = children(skeleton, joint);
    let bone: Vec3 = match (below.next(), below.next()) {
        (Some(child), None) => skeleton.offset(child),
        _ => skeleton.offset(joint),
    };
    let bone = bone.as_dvec3();
    if bone.length() > SHORTEST_BONE { bone } else { DVec3::Y }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skeleton() -> Skeleton {
        let json = include_str!("../../../tests/fixtures/motion/skeleton.json");
        serde_json::from_str(json).unwrap()
    }

    /// World positions of one pose by the rig's own bones.
    fn positions(rig: &Rig, root: DVec3, frame: &[Quat]) -> Vec<DVec3> {
        let mut world: Vec<(DVec3, DQuat)> = Vec::new();
        for (index, bone) in rig.bones.iter().enumerate() {
            let (above, turned) = bone.parent.map_or((DVec3::ZERO, DQuat::IDENTITY), |p| world[p]);
            let place = rig.place(root.as_vec3());
            let offset = if index == rig.hips() { place } else { bone.offset };
            world.push((above + turned * offset, turned * rig.rotation(index, frame)));
        }
        let joints = rig.bones.iter().zip(world).filter(|(bone, _)| bone.joint.is_some());
        joints.map(|(_, (position, _))| position).collect()
    }

    #[test]
    fn every_target_has_the_joints_where_forward_kinematics_has_them() {
        let skeleton = skeleton();
        let turn = |joint: usize| {
            let axis = Vec3::new(1.0, joint as f32 * 0.7 - 5.0, (joint % 5) as f32 - 2.0);
            Quat::from_axis_angle(axis.normalize(), joint as f32 * 0.13)
        };
        let frame: Vec<Quat> = (0..24).map(turn).collect();
        let root = DVec3::new(0.3, 0.9, -2.0);
        let wanted =
            positions(&Rig::new(&skeleton, TargetSkeleton::Smpl, true).unwrap(), root, &frame);
        let animation = bailando_motion::Animation {
            fps: 60,
            root: vec![root.as_vec3()],
            rotations: vec![frame.clone()],
        };
        let forward = bailando_motion::forward(&skeleton, &animation).unwrap();
        for (joint, wanted) in wanted.iter().enumerate() {
            let [x, y, z] = [0, 1, 2].map(|axis| f64::from(forward[[0, joint, axis]]));
            assert!(wanted.distance(DVec3::new(x, y, z)) < 1e-5);
        }
        for target in TargetSkeleton::ALL {
            for own_axes in [false, true] {
                let rig = Rig::new(&skeleton, target, own_axes).unwrap();
                let seen = positions(&rig, root, &frame);
                for (seen, wanted) in seen.iter().zip(&wanted) {
                    assert!(seen.distance(*wanted) < 1e-6, "{target:?}: {seen} is not {wanted}");
                }
            }
        }
    }

    #[test]
    fn the_rest_pose_of_a_target_is_a_t_pose_on_the_floor() {
        let rig = Rig::new(&skeleton(), TargetSkeleton::Vrm, true).unwrap();
        let at = |name: &str| rig.bones.iter().find(|bone| bone.name == name).unwrap().position;
        for side in ["left", "right"] {
            let part = |name: &str| at(&format!("{side}{name}"));
            let (arm, hand) = (part("UpperArm"), part("Hand"));
            assert!((arm.y - hand.y).abs() < 1e-9 && (arm.z - hand.z).abs() < 1e-9);
            assert!((arm.x - hand.x).abs() > 0.5);
            let (leg, foot, toes) = (part("UpperLeg"), part("Foot"), part("Toes"));
            assert!((leg.x - foot.x).abs() < 1e-9 && (leg.z - foot.z).abs() < 1e-9);
            assert!((foot.x - toes.x).abs() < 1e-9 && toes.z > foot.z + 0.1);
            assert!((toes.y - f64::from(STANDING_HEIGHT)).abs() < 0.003, "{toes}");
        }
        assert!((0.9..1.05).contains(&at("hips").y));
    }

    #[test]
    fn a_skeleton_that_a_target_does_not_know_is_refused() {
        let mut skeleton = skeleton();
        skeleton.joints[4] = "tail".into();
        assert!(Rig::new(&skeleton, TargetSkeleton::Smpl, true).is_ok());
        let error = Rig::new(&skeleton, TargetSkeleton::Mixamo, true).unwrap_err().to_string();
        assert!(error.contains("tail") && error.contains("mixamo"), "{error}");
    }
}
