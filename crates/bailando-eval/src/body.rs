//! A motion as the metrics see it: 24 SMPL joints, 60 frames a second, metres, y up.

use glam::{DQuat, DVec3};
use ndarray::ArrayView3;

use crate::error::EvaluationError;

/// Joints of a pose.
pub const JOINTS: usize = 24;
/// Frames per second that every metric assumes.
pub const FRAMES_PER_SECOND: f64 = 60.0;
/// A third difference needs this many frames.
const SHORTEST_MOTION: usize = 4;

/// Joint positions of one frame, metres, world space, SMPL order.
pub type Pose = [DVec3; JOINTS];

/// SMPL joint indices that the metrics name.
pub(crate) mod joint {
    pub(crate) const ROOT: usize = 0;
    pub(crate) const L_HIP: usize = 1;
    pub(crate) const R_HIP: usize = 2;
    pub(crate) const BELLY: usize = 3;
    pub(crate) const L_KNEE: usize = 4;
    pub(crate) const R_KNEE: usize = 5;
    pub(crate) const L_ANKLE: usize = 7;
    pub(crate) const R_ANKLE: usize = 8;
    pub(crate) const CHEST: usize = 9;
    pub(crate) const L_TOES: usize = 10;
    pub(crate) const R_TOES: usize = 11;
    pub(crate) const NECK: usize = 12;
    pub(crate) const HEAD: usize = 15;
    pub(crate) const L_SHOULDER: usize = 16;
    pub(crate) const R_SHOULDER: usize = 17;
    pub(crate) const L_ELBOW: usize = 18;
    pub(crate) const R_ELBOW: usize = 19;
    pub(crate) const L_WRIST: usize = 20;
    pub(crate) const R_WRIST: usize = 21;
}

/// The pose around its root as the dancer sees it: left is +x, and +z is where hips and shoulders
/// face.
pub(crate) fn in_dancer_frame(pose: &Pose) -> Pose {
    let (cosine, sine) = facing(pose);
    pose.map(|place| {
        let place = place - pose[joint::ROOT];
        DVec3::new(cosine * place.x + sine * place.z, place.y, cosine * place.z - sine * place.x)
    })
}

/// Cosine and sine of the turn from the dancer's left to +x, about y.
pub(crate) fn facing(pose: &Pose) -> (f64, f64) {
    use joint::{L_HIP, L_SHOULDER, R_HIP, R_SHOULDER};
    let across = pose[L_HIP] - pose[R_HIP] + pose[L_SHOULDER] - pose[R_SHOULDER];
    let length = across.x.hypot(across.z);
    match length > 1e-9 {
        true => (across.x / length, across.z / length),
        false => (1.0, 0.0),
    }
}

/// Names of the joints in SMPL order, as in data folders, JSON and BVH.
pub(crate) const JOINT_NAMES: &str = "pelvis l_hip r_hip spine1 l_knee r_knee spine2 l_ankle \
    r_ankle spine3 l_foot r_foot neck l_collar r_collar head l_shoulder r_shoulder l_elbow r_elbow \
    l_wrist r_wrist l_hand r_hand";

/// A motion as rotations on a skeleton of SMPL joints.
#[derive(Clone, Debug, PartialEq)]
pub struct SkeletalMotion {
    /// Parent of each joint; the root's is itself.
    pub(crate) parents: [usize; JOINTS],
    /// Offset of each joint from its parent, metres.
    pub(crate) offsets: [DVec3; JOINTS],
    /// Place of the root in every frame, metres.
    pub(crate) root: Vec<DVec3>,
    /// Local rotations in every frame.
    pub(crate) local: Vec<[DQuat; JOINTS]>,
    /// Largest change of a rotation channel from one frame to the next, degrees.
    pub(crate) channel_jump: f64,
}

/// One motion of a set.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    name: String,
    poses: Vec<Pose>,
    codes: Option<[Vec<u32>; 2]>,
    skeletal: Option<SkeletalMotion>,
}

impl Motion {
    /// Takes positions `[frames, 24, 3]`, metres, y up, 60 frames a second.
    ///
    /// # Errors
    /// [`EvaluationError::Motion`] if the shape differs, there are fewer than 4 frames, or a number
    /// is not finite.
    pub fn new(name: &str, positions: ArrayView3<'_, f32>) -> Result<Self, EvaluationError> {
        let poses = poses(positions)
            .map_err(|problem| EvaluationError::Motion { name: name.to_owned(), problem })?;
        Ok(Self { name: name.to_owned(), poses, codes: None, skeletal: None })
    }

    /// Adds the pose codes (upper, lower) that the motion was decoded from.
    #[must_use]
    pub fn with_codes(mut self, codes: [Vec<u32>; 2]) -> Self {
        self.codes = Some(codes);
        self
    }

    /// Adds the rotations that the positions are made of.
    #[must_use]
    pub fn with_rotations(mut self, skeletal: SkeletalMotion) -> Self {
        self.skeletal = Some(skeletal);
        self
    }

    /// Rotations on a skeleton, where the file has them.
    pub(crate) const fn skeletal(&self) -> Option<&SkeletalMotion> {
        self.skeletal.as_ref()
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

    /// Pose codes of upper and lower body, where the file has them.
    #[must_use]
    pub const fn codes(&self) -> Option<&[Vec<u32>; 2]> {
        self.codes.as_ref()
    }
}

fn poses(positions: ArrayView3<'_, f32>) -> Result<Vec<Pose>, String> {
    let (frames, joints, axes) = positions.dim();
    if (joints, axes) != (JOINTS, 3) {
        let shape = positions.shape();
        return Err(format!("expected the shape [frames, {JOINTS}, 3], got {shape:?}"));
    }
    if frames < SHORTEST_MOTION {
        return Err(format!("it has {frames} frames: at least {SHORTEST_MOTION} are needed"));
    }
    let mut cells = positions.indexed_iter();
    if let Some(((frame, joint, _), _)) = cells.find(|(_, value)| !value.is_finite()) {
        return Err(format!("frame {frame}, joint {joint} is not finite"));
    }
    let value = |cell| f64::from(positions[cell]);
    let place = |frame, joint| DVec3::from([0, 1, 2].map(|axis| value((frame, joint, axis))));
    let pose = |frame| std::array::from_fn(|joint| place(frame, joint));
    Ok((0..frames).map(pose).collect())
}

/// Checks that a file's motion is at the frame rate that every metric assumes.
pub(crate) fn check_rate(frames_per_second: f64) -> Result<(), String> {
    // BVH rounds its frame time.
    if (frames_per_second - FRAMES_PER_SECOND).abs() < 0.01 {
        return Ok(());
    }
    Err(format!("it has {frames_per_second} frames a second: the metrics are defined for 60"))
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    #[test]
    fn positions_that_are_no_motion_are_refused_with_their_name() {
        let mut broken = Array3::zeros((10, JOINTS, 3));
        broken[(7, 4, 1)] = f32::NAN;
        for (positions, words) in [
            (Array3::zeros((10, 22, 3)), "[10, 22, 3]"),
            (Array3::zeros((3, JOINTS, 3)), "3 frames"),
            (broken, "frame 7, joint 4"),
        ] {
            let error = Motion::new("waltz", positions.view()).unwrap_err();
            let message = error.to_string();
            assert!(message.contains("waltz") && message.contains(words), "{message}");
        }
    }
}
