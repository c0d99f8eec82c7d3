//! One pose in world space.

use glam::{DQuat, DVec3, Quat, Vec3};

use crate::skeleton::Skeleton;

/// World positions and rotations of all joints in one frame; planned once, then filled in place.
#[derive(Clone, Debug)]
pub(crate) struct WorldPose {
    parents: Vec<Option<usize>>,
    /// The joints that are posed, parents before their children.
    posed: Vec<usize>,
    offsets: Vec<DVec3>,
    places: Vec<DVec3>,
    turns: Vec<DQuat>,
}

impl WorldPose {
    pub(crate) fn new(skeleton: &Skeleton) -> Self {
        let joints = 0..skeleton.joints.len();
        Self {
            parents: joints.clone().map(|joint| skeleton.parent(joint)).collect(),
            posed: joints.clone().collect(),
            offsets: joints.clone().map(|joint| skeleton.offset(joint).as_dvec3()).collect(),
            places: vec![DVec3::ZERO; joints.len()],
            turns: vec![DQuat::IDENTITY; joints.len()],
        }
    }

    /// Poses these joints alone, and those above them; the others stay where they are.
    pub(crate) fn only(mut self, joints: &[usize]) -> Self {
        let mut is_needed = vec![false; self.parents.len()];
        for &joint in joints {
            let above = std::iter::successors(Some(joint), |&joint| self.parents[joint]);
            above.for_each(|joint| is_needed[joint] = true);
        }
        self.posed.retain(|&joint| is_needed[joint]);
        self
    }

    /// Number of joints.
    pub(crate) fn joints(&self) -> usize {
        self.parents.len()
    }

    /// Poses the skeleton.
    pub(crate) fn set(&mut self, root: Vec3, rotations: &[Quat]) {
        for &joint in &self.posed {
            let local = rotations[joint].as_dquat();
            (self.places[joint], self.turns[joint]) = match self.parents[joint] {
                None => (root.as_dvec3(), local.normalize()),
                Some(parent) => {
                    let turn = self.turns[parent];
                    let place = self.places[parent] + turn * self.offsets[joint];
                    (place, (turn * local).normalize())
                }
            };
        }
    }

    /// World position of a joint, metres.
    pub(crate) fn place(&self, joint: usize) -> DVec3 {
        self.places[joint]
    }

    /// World rotation of a joint.
    pub(crate) fn turn(&self, joint: usize) -> DQuat {
        self.turns[joint]
    }

    /// World rotation of a joint's parent; none for the root.
    pub(crate) fn turn_above(&self, joint: usize) -> DQuat {
        self.parents[joint].map_or(DQuat::IDENTITY, |parent| self.turns[parent])
    }
}
