//! Inverse kinematics: joint positions to local rotations on the rest skeleton.

use glam::{DQuat, DVec3};

use crate::{
    animation::{Animation, Positions, position},
    error::MotionError,
    fit::{best_rotation, nearer_sign, smallest_rotation},
    root::check_finite,
    skeleton::Skeleton,
};

/// Bones shorter than this, in metres, have no direction.
pub(crate) const SHORTEST_BONE: f64 = 1e-6;
/// Fastest change of a bone's twist beyond what its direction carries along, radians a second.
/// Dancers' limbs stay far below it; only the neighbourhood of a half turn from rest reaches it.
pub(crate) const TWIST_RATE: f64 = 30.0;

/// A solver for the rotations that put a rest skeleton on given joint positions.
///
/// A joint with several children gets the best-fitting rotation, one with a single child the
/// smallest rotation from the rest direction in its parent's frame, a leaf the identity. Planned
/// once per skeleton.
#[derive(Clone, Debug)]
pub struct InverseKinematics {
    bones: Vec<Bone>,
}

/// A joint's parent, and its children with their offsets.
#[derive(Clone, Debug)]
struct Bone {
    parent: Option<usize>,
    children: Vec<(usize, DVec3)>,
}

impl InverseKinematics {
    /// Plans for a skeleton.
    ///
    /// # Errors
    /// [`MotionError::Skeleton`] if it contradicts itself.
    pub fn new(skeleton: &Skeleton) -> Result<Self, MotionError> {
        skeleton.validate()?;
        let mut bones: Vec<Bone> = Vec::with_capacity(skeleton.joints.len());
        for joint in 0..skeleton.joints.len() {
            let parent = skeleton.parent(joint);
            if let Some(parent) = parent {
                let offset = skeleton.offset(joint).as_dvec3();
                bones[parent].children.push((joint, offset));
            }
            bones.push(Bone { parent, children: Vec::new() });
        }
        Ok(Self { bones })
    }

    /// Solves for the local rotations of `positions` `[frames, joints, 3]` (metres, world space) at
    /// `fps`.
    ///
    /// Quaternions are of unit length and keep their sign along time. Bones without length keep the
    /// previous frame's rotation.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the joints are not the skeleton's, [`MotionError::NotFinite`] for
    /// a NaN or an infinity.
    pub fn solve(&self, positions: &Positions, fps: u32) -> Result<Animation, MotionError> {
        self.continue_from(&mut self.start(fps), positions)
    }

    /// Returns the state before the first frame of a motion at `fps`.
    pub(crate) fn start(&self, fps: u32) -> Solution {
        let joints = self.bones.len();
        Solution {
            fps,
            positions: vec![DVec3::ZERO; joints],
            local: vec![DQuat::IDENTITY; joints],
            world: vec![DQuat::IDENTITY; joints],
            started: false,
            max_twist: TWIST_RATE / f64::from(fps.max(1)),
        }
    }

    /// [`InverseKinematics::solve`] for the frames after those that `solution` has seen.
    pub(crate) fn continue_from(
        &self,
        solution: &mut Solution,
        positions: &Positions,
    ) -> Result<Animation, MotionError> {
        let (frames, joints, axes) = positions.dim();
        if joints != self.bones.len() || axes != 3 {
            return Err(MotionError::Shape {
                expected: format!("[frames, {}, 3]", self.bones.len()),
                got: format!("[{frames}, {joints}, {axes}]"),
            });
        }
        check_finite(positions)?;
        let mut animation = Animation::empty(solution.fps);
        for frame in positions.outer_iter() {
            for (target, joint) in solution.positions.iter_mut().zip(frame.outer_iter()) {
                *target = position(joint);
            }
            for (joint, bone) in self.bones.iter().enumerate() {
                solution.solve_joint(joint, bone);
            }
            solution.started = true;
            animation.root.push(solution.positions[0].as_vec3());
            let rotations = solution.local.iter().map(|q| q.as_quat().normalize());
            animation.rotations.push(rotations.collect());
        }
        Ok(animation)
    }
}

/// The last solved frame of a motion; while a frame is being solved, `local` still holds the
/// previous frame's rotation of the joints to come.
#[derive(Clone, Debug)]
pub(crate) struct Solution {
    fps: u32,
    positions: Vec<DVec3>,
    local: Vec<DQuat>,
    world: Vec<DQuat>,
    started: bool,
    max_twist: f64,
}

impl Solution {
    fn solve_joint(&mut self, joint: usize, bone: &Bone) {
        let above = bone.parent.map_or(DQuat::IDENTITY, |p| self.world[p]);
        let into_parent = above.inverse();
        let origin = self.positions[joint];
        let seen = |child: usize| into_parent * (self.positions[child] - origin);
        let previous = self.local[joint];
        let local = match bone.children.as_slice() {
            [] => previous,
            &[(child, offset)] => match (offset.try_normalize(), seen(child)) {
                (Some(rest), bone) if bone.length() > SHORTEST_BONE => {
                    let previous = self.started.then_some(previous);
                    smallest_rotation(rest, bone.normalize(), previous, self.max_twist)
                }
                _ => previous,
            },
            children => {
                let pairs = children.iter().map(|&(child, offset)| (offset, seen(child)));
                best_rotation(pairs, previous)
            }
        };
        self.local[joint] = nearer_sign(local, previous);
        self.world[joint] = (above * self.local[joint]).normalize();
    }
}
