//! The head, which the solver leaves rigid on the neck.

use glam::Quat;

use crate::skeleton::Skeleton;

/// The head follows this share of the neck's turn: dancers level their eyes.
const FOLLOWED: f32 = 0.5;

/// Neck and head of a skeleton.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    neck: usize,
    head: usize,
}

impl Head {
    pub(super) fn of(skeleton: &Skeleton) -> Option<Self> {
        let head = skeleton.joints.iter().position(|name| name == "head")?;
        Some(Self { neck: skeleton.parent(head)?, head })
    }

    /// Returns the joint that it turns.
    pub(super) fn joint(self) -> usize {
        self.head
    }

    /// Turns the head back by the share of the neck's turn that it does not follow.
    pub(super) fn level(self, rotations: &mut [Quat]) {
        let neck = rotations[self.neck];
        let neck = if neck.w < 0.0 { -neck } else { neck };
        rotations[self.head] = Quat::IDENTITY.slerp(neck.inverse(), 1.0 - FOLLOWED).normalize();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_head_follows_half_of_the_necks_turn() {
        let head = Head::of(&Skeleton::fixture()).unwrap();
        for turn in [Quat::from_rotation_x(0.8), -Quat::from_rotation_x(0.8)] {
            let mut pose = vec![Quat::IDENTITY; 24];
            pose[head.neck] = turn;
            head.level(&mut pose);
            let facing = pose[head.neck] * pose[head.head];
            assert!(facing.angle_between(Quat::from_rotation_x(0.4)) < 1e-3);
        }
    }
}
