//! A motion as the metrics see it: 24 SMPL joints, 60 frames a second, metres, y up.

use glam::DVec3;
use ndarray::ArrayView3;

use super::EvaluationError;

/// Joints of a pose.
pub const JOINTS: usize = 24;
/// Frames per second that every metric assumes.
pub const FRAMES_PER_SECOND: f64 = 60.0;
/// A third difference needs this many frames.
pub const SHORTEST_MOTION: usize = 4;

/// Joint positions of one frame, metres, world space, SMPL order.
pub type Pose = [DVec3; JOINTS];

/// SMPL joint indices that the metrics name.
pub(super) mod joint {
    pub(in super::super) const ROOT: usize = 0;
    pub(in super::super) const LEFT_HIP: usize = 1;
    pub(in super::super) const RIGHT_HIP: usize = 2;
    pub(in super::super) const BELLY: usize = 3;
    pub(in super::super) const LEFT_KNEE: usize = 4;
    pub(in super::super) const RIGHT_KNEE: usize = 5;
    pub(in super::super) const LEFT_ANKLE: usize = 7;
    pub(in super::super) const RIGHT_ANKLE: usize = 8;
    pub(in super::super) const CHEST: usize = 9;
    pub(in super::super) const LEFT_TOES: usize = 10;
    pub(in super::super) const RIGHT_TOES: usize = 11;
    pub(in super::super) const NECK: usize = 12;
    pub(in super::super) const LEFT_SHOULDER: usize = 16;
    pub(in super::super) const RIGHT_SHOULDER: usize = 17;
    pub(in super::super) const LEFT_ELBOW: usize = 18;
    pub(in super::super) const RIGHT_ELBOW: usize = 19;
    pub(in super::super) const LEFT_WRIST: usize = 20;
    pub(in super::super) const RIGHT_WRIST: usize = 21;
}

/// Names of the joints in SMPL order, as in data folders, JSON and BVH.
pub const JOINT_NAMES: [&str; JOINTS] = [
    "pelvis",
    "l_hip",
    "r_hip",
    "spine1",
    "l_knee",
    "r_knee",
    "spine2",
    "l_ankle",
    "r_ankle",
    "spine3",
    "l_foot",
    "r_foot",
    "neck",
    "l_collar",
    "r_collar",
    "head",
    "l_shoulder",
    "r_shoulder",
    "l_elbow",
    "r_elbow",
    "l_wrist",
    "r_wrist",
    "l_hand",
    "r_hand",
];

/// One motion of a set.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    name: String,
    poses: Vec<Pose>,
    codes: Option<[Vec<u32>; 2]>,
}

impl Motion {
    /// A motion from positions `[frames, 24, 3]`, metres, y up, 60 frames a second.
    ///
    /// # Errors
    /// [`EvaluationError::Motion`] if the shape differs, there are fewer than
    /// [`SHORTEST_MOTION`] frames, or a number is not finite.
    pub fn new(name: &str, positions: ArrayView3<'_, f32>) -> Result<Self, EvaluationError> {
        let fail = |problem: String| {
            Err(EvaluationError::Motion {
                name: name.to_owned(),
                problem,
            })
        };
        let shape = positions.dim();
        if (shape.1, shape.2) != (JOINTS, 3) {
            return fail(format!(
                "expected the shape [frames, {JOINTS}, 3], got {:?}",
                positions.shape()
            ));
        }
        if shape.0 < SHORTEST_MOTION {
            return fail(format!(
                "it has {} frames: at least {SHORTEST_MOTION} are needed",
                shape.0
            ));
        }
        let mut poses = Vec::with_capacity(shape.0);
        for (frame, cells) in positions.outer_iter().enumerate() {
            let mut pose = [DVec3::ZERO; JOINTS];
            for (joint, (place, cell)) in pose.iter_mut().zip(cells.outer_iter()).enumerate() {
                for (axis, &value) in cell.iter().enumerate() {
                    if !value.is_finite() {
                        return fail(format!("frame {frame}, joint {joint} is not finite"));
                    }
                    place[axis] = f64::from(value);
                }
            }
            poses.push(pose);
        }
        Ok(Self {
            name: name.to_owned(),
            poses,
            codes: None,
        })
    }

    /// The same motion with the pose codes (upper, lower) that it was decoded from.
    #[must_use]
    pub fn with_codes(mut self, codes: [Vec<u32>; 2]) -> Self {
        self.codes = Some(codes);
        self
    }

    /// Its name: a generated motion's is the id of its piece.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// One pose per frame.
    #[must_use]
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// Pose codes of upper and lower body, where the file tells them.
    #[must_use]
    pub fn codes(&self) -> Option<&[Vec<u32>; 2]> {
        self.codes.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    #[test]
    fn what_is_no_motion_is_refused_with_its_name() {
        let mut broken = Array3::zeros((10, JOINTS, 3));
        broken[(7, 4, 1)] = f32::NAN;
        for (positions, words) in [
            (Array3::zeros((10, 22, 3)), "[10, 22, 3]"),
            (Array3::zeros((3, JOINTS, 3)), "3 frames"),
            (broken, "frame 7, joint 4"),
        ] {
            let message = Motion::new("waltz", positions.view())
                .unwrap_err()
                .to_string();
            assert!(
                message.contains("waltz") && message.contains(words),
                "{message}"
            );
        }
    }
}
