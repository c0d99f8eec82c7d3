//! Left and right exchanged.

use ndarray::{Array2, ArrayView2};

use crate::skeleton::Skeleton;

/// Exchanges the sides of decoded motion.
#[derive(Clone, Debug)]
pub(crate) struct Mirror {
    /// For every joint the one on the other side; joints of the middle stand for themselves.
    other: Vec<usize>,
}

impl Mirror {
    /// Of a skeleton whose sides are named `l_` and `r_`.
    pub(crate) fn of(skeleton: &Skeleton) -> Self {
        let named = |name: &str| skeleton.joints.iter().position(|joint| joint == name);
        let other = skeleton.joints.iter().enumerate().map(|(joint, name)| {
            let other = match (name.strip_prefix("l_"), name.strip_prefix("r_")) {
                (Some(rest), _) => named(&format!("r_{rest}")),
                (_, Some(rest)) => named(&format!("l_{rest}")),
                _ => None,
            };
            other.unwrap_or(joint)
        });
        Self { other: other.collect() }
    }

    /// Returns rows `[frames, 3 joints]`, of places or of velocities, with x negated and the sides
    /// exchanged; columns that are no joint's stay.
    pub(crate) fn apply(&self, rows: ArrayView2<'_, f32>) -> Array2<f32> {
        Array2::from_shape_fn(rows.dim(), |(row, column)| {
            let (joint, axis) = (column / 3, column % 3);
            let Some(&other) = self.other.get(joint) else { return rows[[row, column]] };
            let value = rows.get([row, 3 * other + axis]).copied().unwrap_or_default();
            if axis == 0 { -value } else { value }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FinishOptions, finish};

    #[test]
    fn twice_is_the_motion_itself() {
        let rows = Array2::from_shape_fn((9, 72), |(row, column)| (row * 72 + column) as f32);
        let mirror = Mirror::of(&Skeleton::fixture());
        let once = mirror.apply(rows.view());
        // The left hand's x comes from the right one's.
        assert_eq!(once[[2, 66]], -rows[[2, 69]]);
        assert_eq!(once[[2, 67]], rows[[2, 70]]);
        assert_eq!(once[[2, 2]], rows[[2, 2]]);
        assert_eq!(mirror.apply(once.view()), rows);
    }

    #[test]
    fn a_mirrored_motion_has_its_joints_where_a_mirror_shows_them() {
        let skeleton = Skeleton::fixture();
        let rows = Array2::from_shape_fn((90, 72), |(row, column)| {
            let (joint, axis) = (column / 3, column % 3);
            let mut place = glam::Vec3::ZERO;
            let mut at = Some(joint);
            while let Some(joint) = at {
                place += skeleton.offset(joint);
                at = skeleton.parent(joint);
            }
            let sway = (0.1 * row as f32 + joint as f32).sin();
            if joint == 0 { 0.01 * (axis as f32 - 1.0) } else { place[axis] + 0.02 * sway }
        });
        for clean in [false, true] {
            let of = |mirror| {
                let options = FinishOptions { mirror, clean, ..FinishOptions::default() };
                finish(rows.view(), &skeleton, &options).unwrap().positions
            };
            let (plain, mirrored) = (of(false), of(true));
            let other = Mirror::of(&skeleton).other;
            for ((frame, joint, axis), &found) in mirrored.indexed_iter() {
                let wanted = plain[[frame, other[joint], axis]];
                let wanted = if axis == 0 { -wanted } else { wanted };
                // The sides of the skeleton itself differ by a centimetre or two.
                let apart = (found - wanted).abs();
                assert!(apart < 0.06, "frame {frame}, joint {joint}: {apart}");
            }
        }
    }
}
