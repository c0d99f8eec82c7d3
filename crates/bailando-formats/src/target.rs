//! The skeletons that a motion can be written for.

use std::{f64::consts::FRAC_PI_2, str::FromStr};

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::error::FormatError;

/// A skeleton that characters and animation programs know: names, hierarchy, rest pose and bone
/// axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum TargetSkeleton {
    /// The model's own (SMPL): its rest pose, axes of every bone parallel to the world's.
    #[default]
    Smpl,
    /// Mixamo: T-pose, y along the bone.
    Mixamo,
    /// VRM humanoid: T-pose, axes parallel to the world's.
    Vrm,
    /// Unreal mannequin: T-pose, x along the bone (mirrored on the right), z the hinge of elbows
    /// and knees, a `root` on the floor.
    Unreal,
}

/// Joint names of SMPL with those of Mixamo, VRM and Unreal.
const NAMES: [[&str; 4]; 24] = [
    ["pelvis", "Hips", "hips", "pelvis"],
    ["l_hip", "LeftUpLeg", "leftUpperLeg", "thigh_l"],
    ["r_hip", "RightUpLeg", "rightUpperLeg", "thigh_r"],
    ["spine1", "Spine", "spine", "spine_01"],
    ["l_knee", "LeftLeg", "leftLowerLeg", "calf_l"],
    ["r_knee", "RightLeg", "rightLowerLeg", "calf_r"],
    ["spine2", "Spine1", "chest", "spine_02"],
    ["l_ankle", "LeftFoot", "leftFoot", "foot_l"],
    ["r_ankle", "RightFoot", "rightFoot", "foot_r"],
    ["spine3", "Spine2", "upperChest", "spine_03"],
    ["l_foot", "LeftToeBase", "leftToes", "ball_l"],
    ["r_foot", "RightToeBase", "rightToes", "ball_r"],
    ["neck", "Neck", "neck", "neck_01"],
    ["l_collar", "LeftShoulder", "leftShoulder", "clavicle_l"],
    ["r_collar", "RightShoulder", "rightShoulder", "clavicle_r"],
    ["head", "Head", "head", "head"],
    ["l_shoulder", "LeftArm", "leftUpperArm", "upperarm_l"],
    ["r_shoulder", "RightArm", "rightUpperArm", "upperarm_r"],
    ["l_elbow", "LeftForeArm", "leftLowerArm", "lowerarm_l"],
    ["r_elbow", "RightForeArm", "rightLowerArm", "lowerarm_r"],
    ["l_wrist", "LeftHand", "leftHand", "hand_l"],
    ["r_wrist", "RightHand", "rightHand", "hand_r"],
    ["l_hand", "LeftHandMiddle1", "leftMiddleProximal", "middle_01_l"],
    ["r_hand", "RightHandMiddle1", "rightMiddleProximal", "middle_01_r"],
];

impl TargetSkeleton {
    /// Every target, the default first.
    pub const ALL: [Self; 4] = [Self::Smpl, Self::Mixamo, Self::Vrm, Self::Unreal];

    /// Returns its name in options.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Smpl => "smpl",
            Self::Mixamo => "mixamo",
            Self::Vrm => "vrm",
            Self::Unreal => "unreal",
        }
    }

    /// Returns the joints of SMPL in its order.
    pub(crate) fn smpl_joints() -> impl Iterator<Item = &'static str> {
        NAMES.iter().map(|names| names[0])
    }

    /// Returns the target's name of a joint of SMPL; none for a joint that SMPL has not.
    #[must_use]
    pub fn bone_name(self, joint: &str) -> Option<String> {
        let names = NAMES.iter().find(|names| names[0] == joint);
        match self {
            Self::Smpl => Some(joint.to_owned()),
            Self::Mixamo => names.map(|names| format!("mixamorig:{}", names[1])),
            Self::Vrm => names.map(|names| names[2].to_owned()),
            Self::Unreal => names.map(|names| names[3].to_owned()),
        }
    }

    /// Returns the bone that stands on the floor above all others, and its rest axes. Unreal's
    /// world is z up: with y up there, Blender would join the hips to its end and drop their path.
    pub(crate) fn floor_bone(self) -> Option<(&'static str, DQuat)> {
        let z_up = DQuat::from_rotation_x(-FRAC_PI_2);
        (self == Self::Unreal).then_some(("root", z_up))
    }

    /// Returns the target's axes in the rest pose, as a rotation from the world's, of the bone of
    /// this joint, which points along `direction` (of unit length).
    pub(crate) fn axes(self, joint: &str, direction: DVec3) -> DQuat {
        match self {
            Self::Smpl | Self::Vrm => DQuat::IDENTITY,
            Self::Mixamo => {
                let y = if is_trunk(joint) { DVec3::Y } else { direction };
                let x = y.cross(DVec3::Z).normalize();
                from_axes(x, y)
            }
            Self::Unreal => unreal_axes(joint, direction),
        }
    }
}

fn is_trunk(joint: &str) -> bool {
    matches!(joint, "pelvis" | "spine1" | "spine2" | "spine3" | "neck" | "head")
}

/// On the left and in the middle, x follows the bone (legs: against it) and y points backward. The
/// right side is the left one's mirror image with all axes turned round, so that the same angles
/// mean the same movement.
fn unreal_axes(joint: &str, direction: DVec3) -> DQuat {
    if joint.starts_with("r_") {
        let mirrored =
            unreal_axes(&joint.replacen('r', "l", 1), direction * DVec3::new(-1., 1., 1.));
        let turned = |axis: DVec3| mirrored * axis * DVec3::new(1.0, -1.0, -1.0);
        return from_axes(turned(DVec3::X), turned(DVec3::Y));
    }
    let x = match joint {
        "l_hip" | "l_knee" => -direction,
        "l_ankle" | "l_foot" => DVec3::Y,
        _ if is_trunk(joint) => DVec3::Y,
        _ => direction,
    };
    let y = (DVec3::NEG_Z - x * x.dot(DVec3::NEG_Z)).normalize();
    from_axes(x, y)
}

/// Returns the rotation whose x and y axes these are, which are of unit length and at a right
/// angle.
fn from_axes(x: DVec3, y: DVec3) -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))).normalize()
}

impl FromStr for TargetSkeleton {
    type Err = FormatError;

    fn from_str(name: &str) -> Result<Self, FormatError> {
        let found = Self::ALL.into_iter().find(|target| target.name() == name);
        found.ok_or_else(|| FormatError::Choice {
            name: "skeleton",
            got: name.into(),
            accepted: "smpl, mixamo, vrm or unreal",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lead_to_their_targets_and_others_are_refused() {
        for target in TargetSkeleton::ALL {
            assert_eq!(target.name().parse::<TargetSkeleton>().unwrap(), target);
        }
        let error = "maya".parse::<TargetSkeleton>().unwrap_err().to_string();
        assert!(error.ends_with("choose smpl, mixamo, vrm or unreal"), "{error}");
    }

    #[test]
    fn axes_are_those_of_the_target() {
        let near = |a: DVec3, b: DVec3| assert!(a.distance(b) < 1e-12, "{a} is not {b}");
        let mixamo = |joint, direction, axis| TargetSkeleton::Mixamo.axes(joint, direction) * axis;
        near(mixamo("l_elbow", DVec3::X, DVec3::Y), DVec3::X);
        near(mixamo("l_hip", DVec3::NEG_Y, DVec3::Y), DVec3::NEG_Y);
        near(mixamo("l_hip", DVec3::NEG_Y, DVec3::Z), DVec3::Z);
        let unreal = |joint, direction, axis| TargetSkeleton::Unreal.axes(joint, direction) * axis;
        near(unreal("l_hip", DVec3::NEG_Y, DVec3::X), DVec3::Y);
        near(unreal("r_hip", DVec3::NEG_Y, DVec3::X), DVec3::NEG_Y);
        near(unreal("l_elbow", DVec3::X, DVec3::X), DVec3::X);
        near(unreal("r_elbow", DVec3::NEG_X, DVec3::X), DVec3::X);
        // The same angle about z swings both forearms to the front.
        let bent = |joint, bone| {
            let axes = TargetSkeleton::Unreal.axes(joint, bone);
            axes * DQuat::from_rotation_z(-1.0) * axes.inverse() * bone
        };
        assert!(bent("l_elbow", DVec3::X).z > 0.8, "{}", bent("l_elbow", DVec3::X));
        near(bent("l_elbow", DVec3::X) * DVec3::new(-1., 1., 1.), bent("r_elbow", DVec3::NEG_X));
    }
}
