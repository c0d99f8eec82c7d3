//! Capsules that arms stay out of: head, torso and hips.

use glam::DVec3;

use super::pose::WorldPose;
use crate::skeleton::Skeleton;

/// Radius of the head with a hand's thickness, metres.
const HEAD: f64 = 0.115;
/// Height of the skull's centre above the head joint, metres.
const SKULL: f64 = 0.10;
/// Radius of the torso, metres: half of its depth. Hands rest on hips and belly.
const TORSO: f64 = 0.10;
/// Half of the width of the hips between their rounded sides, and these sides' radius, metres.
const HIPS: (f64, f64) = (0.05, 0.105);

/// A line with a thickness.
#[derive(Clone, Copy, Debug)]
pub(super) struct Capsule {
    pub(super) ends: [DVec3; 2],
    pub(super) radius: f64,
}

impl Capsule {
    /// Returns the shortest way out for a point inside; zero for one outside.
    pub(super) fn way_out(&self, point: DVec3) -> DVec3 {
        let [start, end] = self.ends;
        let line = end - start;
        let part = (point - start).dot(line) / line.length_squared().max(1e-12);
        let away = point - (start + line * part.clamp(0.0, 1.0));
        let depth = (self.radius - away.length()).max(0.0);
        away.try_normalize().unwrap_or_else(|| line.any_orthogonal_vector().normalize_or_zero())
            * depth
    }

    /// Returns the direction from the capsule's line to a line through `point` along `direction`,
    /// shorter the more the two are parallel.
    pub(super) fn side_of(&self, point: DVec3, direction: DVec3) -> DVec3 {
        let [start, end] = self.ends;
        let across = (end - start).normalize_or_zero().cross(direction);
        if (point - start).dot(across) < 0.0 { -across } else { across }
    }
}

/// The joints that carry the capsules.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    head: usize,
    hips: usize,
    belly: usize,
    chest: usize,
}

impl Body {
    pub(super) fn of(skeleton: &Skeleton) -> Option<Self> {
        let joint = |name: &str| skeleton.joints.iter().position(|joint| joint == name);
        let (head, hips) = (joint("head")?, joint("pelvis")?);
        Some(Self { head, hips, belly: joint("spine1")?, chest: joint("neck")? })
    }

    /// Returns the joints that carry the capsules.
    pub(super) fn joints(self) -> [usize; 4] {
        [self.head, self.hips, self.belly, self.chest]
    }

    /// Returns the capsules of a pose.
    pub(super) fn capsules(self, pose: &WorldPose) -> [Capsule; 3] {
        let head = pose.place(self.head);
        let skull = head + pose.turn(self.head) * (DVec3::Y * SKULL);
        let torso = [pose.place(self.belly), pose.place(self.chest)];
        let (half_width, radius) = HIPS;
        let (hips, side) = (pose.place(self.hips), pose.turn(self.hips) * (DVec3::X * half_width));
        [
            Capsule { ends: [head, skull], radius: HEAD },
            Capsule { ends: torso, radius: TORSO },
            Capsule { ends: [hips - side, hips + side], radius },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_inside_leave_by_the_shortest_way() {
        let capsule = Capsule { ends: [DVec3::ZERO, DVec3::Y], radius: 0.2 };
        for point in [DVec3::new(0.05, 0.4, 0.0), DVec3::new(0.0, 1.1, 0.1), DVec3::Y * 0.5] {
            let out = point + capsule.way_out(point);
            let on_line = DVec3::Y * out.y.clamp(0.0, 1.0);
            assert!(((out - on_line).length() - 0.2).abs() < 1e-9, "{point}");
        }
        assert_eq!(capsule.way_out(DVec3::X * 0.3), DVec3::ZERO);
    }
}
