//! The rest skeleton: names, parents and offsets.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::error::MotionError;

/// Joints this close to the height of the lowest one are feet, metres.
const FOOT_HEIGHT: f32 = 0.05;

/// A rest skeleton, metres, y up, right-handed, heading for +z, left = +x.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Skeleton {
    /// Joint names, SMPL order.
    pub joints: Vec<String>,
    /// Parent of each joint; -1 for the root, which comes first. Parents precede their children.
    pub parents: Vec<i32>,
    /// Offset of each joint from its parent in the rest pose, metres.
    pub offsets: Vec<[f32; 3]>,
    /// Height in metres at which the root starts above the floor y = 0.
    pub root_height: f32,
}

impl Skeleton {
    /// Checks that the tables fit each other.
    ///
    /// # Errors
    /// [`MotionError::Skeleton`] names the first contradiction.
    pub fn validate(&self) -> Result<(), MotionError> {
        let joints = self.joints.len();
        let fail = |message: String| Err(MotionError::Skeleton(message));
        if joints == 0 {
            return fail("it has no joints".into());
        }
        let (parents, offsets) = (self.parents.len(), self.offsets.len());
        if parents != joints || offsets != joints {
            return fail(format!(
                "{joints} joints, {parents} parents and {offsets} offsets: the three must be equal"
            ));
        }
        for (joint, &parent) in self.parents.iter().enumerate() {
            let fits = match usize::try_from(parent) {
                Ok(parent) => joint > 0 && parent < joint,
                Err(_) => joint == 0 && parent == -1,
            };
            if !fits {
                return fail(format!(
                    "joint {joint} has parent {parent}: the root comes first with -1, every other \
                     joint after its parent"
                ));
            }
        }
        let infinite = |offset: &[f32; 3]| !offset.iter().all(|v| v.is_finite());
        if let Some(joint) = self.offsets.iter().position(infinite) {
            return fail(format!("the offset of joint {joint} is not finite"));
        }
        if !self.root_height.is_finite() {
            return fail("root_height is not finite".into());
        }
        Ok(())
    }

    /// Returns the parent of `joint`; `None` for the root.
    #[must_use]
    pub fn parent(&self, joint: usize) -> Option<usize> {
        let parent = self.parents.get(joint)?;
        usize::try_from(*parent).ok()
    }

    /// Returns the offset of `joint` from its parent in the rest pose, metres.
    ///
    /// # Panics
    /// If the skeleton has no such joint.
    #[must_use]
    pub fn offset(&self, joint: usize) -> Vec3 {
        self.offsets[joint].into()
    }

    /// Returns the joints that stand on the floor: those named `l_foot` and `r_foot` (SMPL 10 and
    /// 11), else the lowest joint of the rest pose and its equals within 5 cm.
    #[must_use]
    pub fn foot_joints(&self) -> Vec<usize> {
        let is_foot = |joint: &usize| matches!(self.joints[*joint].as_str(), "l_foot" | "r_foot");
        let named: Vec<usize> = (0..self.joints.len()).filter(is_foot).collect();
        if !named.is_empty() {
            return named;
        }
        let mut heights = vec![0.0_f32; self.joints.len()];
        for joint in 0..self.joints.len() {
            if let (Some(parent), Some(offset)) = (self.parent(joint), self.offsets.get(joint)) {
                heights[joint] = heights[parent] + offset[1];
            }
        }
        let lowest = heights.iter().copied().fold(f32::INFINITY, f32::min);
        (0..heights.len()).filter(|&joint| heights[joint] <= lowest + FOOT_HEIGHT).collect()
    }

    /// Returns the skeleton of the motion that models are trained on.
    #[cfg(test)]
    pub(crate) fn fixture() -> Self {
        serde_json::from_str(include_str!("../../../tests/fixtures/motion/skeleton.json")).unwrap()
    }
}
