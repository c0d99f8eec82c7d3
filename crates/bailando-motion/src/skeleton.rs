//! The rest skeleton: names, parents and offsets.

use serde::{Deserialize, Serialize};

use super::MotionError;

/// A rest skeleton, metres, y up, right-handed, facing +z, left = +x.
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
        if self.parents.len() != joints || self.offsets.len() != joints {
            return fail(format!(
                "{joints} joints, {} parents and {} offsets: the three must be equal",
                self.parents.len(),
                self.offsets.len()
            ));
        }
        for (joint, &parent) in self.parents.iter().enumerate() {
            let fits = match usize::try_from(parent) {
                Ok(parent) => joint > 0 && parent < joint,
                Err(_) => joint == 0 && parent == -1,
            };
            if !fits {
                return fail(format!(
                    "joint {joint} has parent {parent}: the root comes first with -1, every other joint after its parent"
                ));
            }
        }
        if let Some(joint) = self
            .offsets
            .iter()
            .position(|o| o.iter().any(|v| !v.is_finite()))
        {
            return fail(format!("the offset of joint {joint} is not finite"));
        }
        if !self.root_height.is_finite() {
            return fail("root_height is not finite".into());
        }
        Ok(())
    }

    /// Parent of `joint`; none for the root.
    #[must_use]
    pub fn parent(&self, joint: usize) -> Option<usize> {
        self.parents
            .get(joint)
            .and_then(|&p| usize::try_from(p).ok())
    }

    /// The joints that stand on the floor: those named `l_foot` and `r_foot` (SMPL 10 and 11), else
    /// the lowest joint of the rest pose and its equals within 5 cm.
    #[must_use]
    pub fn foot_joints(&self) -> Vec<usize> {
        let named: Vec<usize> = (0..self.joints.len())
            .filter(|&joint| matches!(self.joints[joint].as_str(), "l_foot" | "r_foot"))
            .collect();
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
        (0..heights.len())
            .filter(|&joint| heights[joint] <= lowest + 0.05)
            .collect()
    }
}
