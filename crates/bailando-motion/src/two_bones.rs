//! Two bones of fixed length between a hip and an ankle: where the knee goes.

use glam::DVec3;

use crate::inverse::SHORTEST_BONE;

/// Share of the full length up to which a leg follows without softening.
const FREE_EXTENSION: f64 = 0.97;

/// Lengths of a thigh and a shank, metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TwoBones {
    pub(crate) thigh: f64,
    pub(crate) shank: f64,
}

impl TwoBones {
    /// Returns how far from the hip the ankle is put when it is wanted at `distance`.
    ///
    /// Up to [`FREE_EXTENSION`] or `extension`, the share of its own length that the leg to be
    /// followed extends to, this is `distance`. From there the full length is only approached: next
    /// to it a millimetre of reach moves the knee by centimetres, and a leg cut off at it pops.
    pub(crate) fn reach(&self, distance: f64, extension: f64) -> f64 {
        let full = self.thigh + self.shank;
        let shortest = (self.thigh - self.shank).abs();
        let free = self.free(extension);
        if distance <= free {
            return distance.max(shortest);
        }
        let left = full - free;
        if left < SHORTEST_BONE {
            return full;
        }
        free + left * (1.0 - (-(distance - free) / left).exp())
    }

    /// Returns the distance up to which [`TwoBones::reach`] is exact, metres.
    pub(crate) fn free(&self, extension: f64) -> f64 {
        (self.thigh + self.shank) * extension.clamp(FREE_EXTENSION, 1.0)
    }

    /// Returns how far the knee stands off the line from hip to ankle, and how far along the line
    /// from the hip, with the two `distance` apart.
    pub(crate) fn knee(&self, distance: f64) -> (f64, f64) {
        let (thigh, shank) = (self.thigh, self.shank);
        let distance = distance.max(SHORTEST_BONE);
        let along = (distance * distance + thigh * thigh - shank * shank) / (2.0 * distance);
        let along = along.clamp(-thigh, thigh);
        ((thigh * thigh - along * along).max(0.0).sqrt(), along)
    }
}

/// Returns the part of `vector` at right angles to the unit vector `axis`.
pub(crate) fn perpendicular(vector: DVec3, axis: DVec3) -> DVec3 {
    vector - axis * vector.dot(axis)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEG: TwoBones = TwoBones { thigh: 0.39, shank: 0.42 };

    #[test]
    fn a_distance_within_reach_is_reached_with_both_lengths_kept() {
        for distance in [0.04, 0.1, 0.3, 0.57, 0.7, 0.78] {
            assert_eq!(LEG.reach(distance, 0.5), distance);
            let (off, along) = LEG.knee(distance);
            assert!((off.hypot(along) - LEG.thigh).abs() < 1e-12);
            assert!((off.hypot(distance - along) - LEG.shank).abs() < 1e-12);
        }
    }

    #[test]
    fn too_far_ends_just_below_the_full_length_without_a_jump() {
        let mut last = LEG.reach(0.7, 0.5);
        let mut last_knee = LEG.knee(last).0;
        for step in 1..=600 {
            let reached = LEG.reach(0.7 + 0.001 * f64::from(step), 0.5);
            assert!(reached >= last && reached - last <= 0.001 + 1e-12 && reached <= 0.81);
            let knee = LEG.knee(reached).0;
            let moved = last_knee - knee;
            assert!(moved < 0.003, "the knee moves by {moved} m");
            (last, last_knee) = (reached, knee);
        }
        assert!(last > 0.81 - 1e-6);
    }

    #[test]
    fn a_straight_leg_stays_as_straight_as_the_one_it_follows() {
        for extension in [0.98, 0.999, 0.999_999, 1.0] {
            let distance = 0.81 * extension;
            assert!((LEG.reach(distance, extension) - distance).abs() < 1e-9);
        }
        let (off, along) = LEG.knee(0.81);
        assert!(off < 1e-6 && (along - 0.39).abs() < 1e-9);
        assert_eq!(LEG.reach(2.0, 1.0), 0.81);
    }

    #[test]
    fn nothing_is_divided_by_zero() {
        let (thigh, shank) = (0.4, 0.4);
        for leg in [LEG, TwoBones { thigh, shank }] {
            for distance in [0.0, 1e-12, 1e9] {
                for extension in [0.0, 1.0, 5.0] {
                    let reached = leg.reach(distance, extension);
                    let (off, along) = leg.knee(reached);
                    assert!(reached.is_finite() && off.is_finite() && along.is_finite());
                    assert!((off.hypot(along) - leg.thigh).abs() < 1e-9);
                }
            }
        }
        assert_eq!(LEG.reach(0.0, 0.0), (LEG.thigh - LEG.shank).abs());
    }
}
