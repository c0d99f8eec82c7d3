//! Legs of fixed length on the decoder's steps.
//!
//! Directions alone are not enough: a decoder shrinks and stretches its legs, by up to a third, and
//! a skeleton that only copies their directions has its feet in the air or in the floor.

use crate::{
    animation::{Animation, FrameQueue, Positions},
    leg::{Leg, LegPose},
    skeleton::Skeleton,
    smooth::{smooth_step, smooth_upper_bound},
};

/// A leg carries all of its weight while its foot is within the first of these of the lower foot's
/// height, and none from the second on, metres. Only such a leg pulls the root down.
const STANDING: (f64, f64) = (0.02, 0.10);
/// The root is never lowered further than this, metres.
const MOST_LOWERED: f64 = 0.05;
/// Seconds that lowering the root starts before it is needed and ends after.
const LOWERING_SECONDS: f64 = 0.2;

/// The legs of a skeleton: every chain of three joints with one child each above a foot.
#[derive(Clone, Debug)]
pub(crate) struct Legs(Vec<Leg>);

impl Legs {
    /// Finds the legs of a valid skeleton; one without such chains has none.
    pub(crate) fn new(skeleton: &Skeleton) -> Self {
        let feet = skeleton.foot_joints().into_iter();
        Self(feet.filter_map(|foot| Leg::above_foot(skeleton, foot)).collect())
    }

    /// Starts to fit the legs of one motion at `fps`.
    pub(crate) fn fit(self, fps: u32) -> LegFitter {
        LegFitter {
            last: vec![None; self.0.len()],
            legs: self.0,
            half_width: (LOWERING_SECONDS * f64::from(fps)).ceil() as usize,
            missing: Vec::new(),
            done: 0,
            solved: Animation::empty(fps),
            decoded: Positions::zeros((0, 0, 3)),
        }
    }
}

/// Bends the legs of an animation to the feet of the decoded positions that it was solved from.
/// Where a standing leg is too short, the root is lowered a little and slowly, so that frames are
/// released once those after them are known.
#[derive(Clone, Debug)]
pub(crate) struct LegFitter {
    legs: Vec<Leg>,
    /// Pose of each leg in the frame released last.
    last: Vec<Option<LegPose>>,
    half_width: usize,
    /// How much lower the root must be, in every frame so far, metres.
    missing: Vec<f64>,
    /// Number of frames released.
    done: usize,
    solved: Animation,
    decoded: Positions,
}

impl LegFitter {
    /// Takes the next frames; returns those whose lowering is known.
    pub(crate) fn push(&mut self, solved: Animation, decoded: &Positions) -> Animation {
        let poses = decoded.outer_iter().enumerate();
        let missing = poses.map(|(frame, pose)| {
            let heights = self.legs.iter().map(|leg| leg.foot_height(pose));
            let lowest = heights.fold(f64::INFINITY, f64::min);
            let missing = self.legs.iter().map(|leg| {
                leg.missing_reach(&solved, frame, pose)
                    * weight_carried(leg.foot_height(pose) - lowest)
            });
            missing.fold(0.0, f64::max).min(MOST_LOWERED)
        });
        self.missing.extend(missing);
        self.solved.push_frames(solved);
        self.decoded.push_frames(decoded.clone());
        // The lowering of a frame depends on those within two half widths.
        self.release(self.missing.len().saturating_sub(2 * self.half_width))
    }

    /// Returns the rest.
    pub(crate) fn end(&mut self) -> Animation {
        self.release(self.missing.len())
    }

    fn release(&mut self, end: usize) -> Animation {
        let count = end.saturating_sub(self.done);
        let mut animation = self.solved.take_frames(count);
        let decoded = self.decoded.take_frames(count);
        let margin = 2 * self.half_width;
        let first = self.done.saturating_sub(margin);
        let last = self.missing.len().min(end + margin);
        let lowered = smooth_upper_bound(&self.missing[first..last], self.half_width);
        let lowered = lowered.into_iter().skip(self.done - first);
        for (root, lowered) in animation.root.iter_mut().zip(lowered) {
            root.y -= lowered as f32;
        }
        for (leg, last) in self.legs.iter().zip(&mut self.last) {
            leg.bend(&mut animation, &decoded, last);
        }
        self.done += count;
        animation
    }
}

/// 1 for a foot as low as the lower one, 0 for one well above it, smooth between.
fn weight_carried(above_lower: f64) -> f64 {
    let (full, none) = STANDING;
    smooth_step((none - above_lower) / (none - full))
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};
    use ndarray::Axis;

    use super::*;
    use crate::{InverseKinematics, animation::position, forward};

    /// Decoded positions whose legs are `scale(frame)` times the skeleton's while the feet stand on
    /// the same spot: the joints above the legs come down or go up with it.
    fn scaled_legs(frames: usize, scale: impl Fn(usize) -> f32) -> Positions {
        let still = Animation {
            fps: 60,
            root: vec![Vec3::new(0.0, 0.96, 0.0)],
            rotations: vec![vec![Quat::IDENTITY; 24]],
        };
        let rest = forward(&Skeleton::fixture(), &still).unwrap();
        let rest = rest.index_axis(Axis(0), 0);
        let mut positions = Positions::zeros((frames, 24, 3));
        for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
            pose.assign(&rest);
            for [hip, knee, ankle, foot] in [[1, 4, 7, 10], [2, 5, 8, 11]] {
                let scale = scale(frame);
                for (child, parent, scale) in
                    [(knee, hip, scale), (ankle, knee, scale), (foot, ankle, 1.0)]
                {
                    for axis in 0..3 {
                        pose[[child, axis]] = pose[[parent, axis]]
                            + scale * (rest[[child, axis]] - rest[[parent, axis]]);
                    }
                }
            }
            // Both legs shrink alike, so lifting the pose by the left one's loss puts it back.
            let gone = pose[[10, 1]] - rest[[10, 1]];
            pose.column_mut(1).mapv_inplace(|y| y - gone);
        }
        positions
    }

    fn fitted(positions: &Positions) -> (Animation, Positions) {
        let skeleton = Skeleton::fixture();
        let solver = InverseKinematics::new(&skeleton).unwrap();
        let solved = solver.solve(positions, 60).unwrap();
        let mut fitter = Legs::new(&skeleton).fit(60);
        let mut animation = fitter.push(solved, positions);
        animation.push_frames(fitter.end());
        let posed = forward(&skeleton, &animation).unwrap();
        (animation, posed)
    }

    fn furthest(a: &Positions, b: &Positions, joint: usize) -> f64 {
        let frames = a.outer_iter().zip(b.outer_iter());
        frames
            .map(|(a, b)| (position(a.row(joint)) - position(b.row(joint))).length())
            .fold(0.0, f64::max)
    }

    #[test]
    fn the_two_legs_are_found_and_other_skeletons_have_none() {
        let Legs(legs) = Legs::new(&Skeleton::fixture());
        let joints: Vec<_> = legs.iter().map(|leg| leg.joints).collect();
        assert_eq!(joints, [[1, 4, 7, 10], [2, 5, 8, 11]]);
        let mut toes = Skeleton::fixture();
        toes.parents[22] = 7;
        assert_eq!(Legs::new(&toes).0.len(), 1);
        let two = Skeleton {
            joints: vec!["root".into(), "l_foot".into()],
            parents: vec![-1, 0],
            offsets: vec![[0.0; 3], [0.0, -1.0, 0.0]],
            root_height: 1.0,
        };
        assert!(Legs::new(&two).0.is_empty());
    }

    #[test]
    fn shrinking_legs_keep_their_feet_and_bend_their_knees_forwards() {
        // Down to two thirds and back within a second.
        let scale = |frame| 1.0 - 0.167 * (1.0 - (frame as f32 * 0.105).cos());
        let shrinking = scaled_legs(120, scale);
        let (animation, posed) = fitted(&shrinking);
        for joint in [0, 7, 8, 10, 11] {
            assert!(furthest(&shrinking, &posed, joint) < 1e-4, "joint {joint}");
        }
        for joint in [4, 5] {
            let path: Vec<_> = posed.outer_iter().map(|pose| position(pose.row(joint))).collect();
            assert!(path[30].z > path[0].z + 0.2, "the knee goes forwards");
            for pair in path.windows(2) {
                assert!((pair[1] - pair[0]).length() < 0.06);
            }
        }
        for pair in animation.rotations.windows(2) {
            assert!(pair[0].iter().zip(&pair[1]).all(|(a, b)| a.dot(*b) >= 0.0));
        }
    }

    #[test]
    fn legs_that_are_too_short_lower_the_root_slowly() {
        let stretched = scaled_legs(240, |frame| if frame == 120 { 1.04 } else { 1.0 });
        let (animation, posed) = fitted(&stretched);
        // The skeleton's leg is 3 cm shorter there.
        let lowered = |frame: usize| stretched[[frame, 0, 1]] - animation.root[frame].y;
        assert!(lowered(120) > 0.015 && lowered(0).abs() < 1e-6);
        for joint in [10, 11] {
            assert!(furthest(&stretched, &posed, joint) < 0.02);
        }
        for frame in 1..240 {
            assert!((lowered(frame) - lowered(frame - 1)).abs() < 0.005);
        }
    }

    #[test]
    fn poses_without_any_length_are_finite() {
        let mut positions = scaled_legs(4, |_| 1.0);
        positions.index_axis_mut(Axis(0), 1).fill(0.5);
        for joint in [4, 7, 10] {
            positions[[2, joint, 1]] = 3.0;
        }
        let (animation, _) = fitted(&positions);
        let mut all = animation.rotations.iter().flatten();
        assert!(all.all(|q| q.is_finite() && q.is_normalized()));
    }
}
