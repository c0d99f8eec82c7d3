//! What an animator sees in the rotations of a motion, which positions alone do not show.

use glam::{DQuat, DVec3};

use crate::body::{
    FRAMES_PER_SECOND, JOINTS, SkeletalMotion,
    joint::{CHEST, HEAD, L_ANKLE, L_ELBOW, L_TOES, L_WRIST, R_ANKLE, R_ELBOW, R_TOES, R_WRIST},
};

/// A forearm that turns about itself faster than this, degrees a second, does what no arm does.
const FAST_TWIST: f64 = 360.0;
/// An elbow bent further than this, degrees, is folded.
const FOLDED: f64 = 150.0;
/// Radius of the head and height of its centre above the head joint, metres.
const HEAD_SIZE: (f64, f64) = (0.10, 0.10);
/// Thickness of the sole below the ball joint, metres: where recorded dancers' balls stand.
const SOLE: f64 = 0.015;
/// Heel and toe tip, shares of the way along the floor from ankle to ball: behind the ankle and
/// ahead of the ball.
const HEEL: f64 = 0.4;
const TOES: f64 = 0.5;

/// A pose: places and rotations in the world.
type World = ([DVec3; JOINTS], [DQuat; JOINTS]);

/// Measures of one motion's rotations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SkeletalQuality {
    /// Lowest point of a sole (heel, ball, toe tip) of all frames, cm.
    pub(crate) lowest_foot: f64,
    /// Share of frames, of both arms, in which a forearm turns about itself against the chest
    /// faster than 360 degrees a second.
    pub(crate) fast_twist: f64,
    /// Share of frames, of both arms, with an elbow beyond 150 degrees.
    pub(crate) folded_elbows: f64,
    /// Share of frames, of both arms, with the wrist inside the head.
    pub(crate) wrist_in_head: f64,
    /// Largest distance of a joint from where interpolation between every other frame has it, cm.
    pub(crate) half_rate_error: f64,
    /// Largest change of a rotation channel from one frame to the next, degrees.
    pub(crate) channel_jump: f64,
}

impl SkeletalQuality {
    pub(crate) fn new(motion: &SkeletalMotion) -> Self {
        let frames = motion.root.iter().zip(&motion.local);
        let poses: Vec<World> = frames.map(|(&root, local)| motion.pose(root, local)).collect();
        let arms = [[L_ELBOW, L_WRIST], [R_ELBOW, R_WRIST]];
        let share = |counts: &dyn Fn(&World, [usize; 2]) -> bool| {
            let each = poses.iter().flat_map(|pose| arms.map(|arm| counts(pose, arm)));
            each.filter(|&counted| counted).count() as f64 / (2 * poses.len().max(1)) as f64
        };
        let steps = poses.iter().zip(poses.iter().skip(1));
        let twists = steps.flat_map(|(before, now)| {
            arms.map(|[elbow, wrist]| motion.twist(before, now, elbow, wrist))
        });
        let fast = twists.filter(|twist| twist.abs() > FAST_TWIST).count();
        let lowest = poses.iter().map(|pose| motion.lowest(pose)).fold(f64::INFINITY, f64::min);
        Self {
            lowest_foot: 100.0 * lowest,
            fast_twist: fast as f64 / (2 * poses.len().saturating_sub(1).max(1)) as f64,
            folded_elbows: share(&|pose, [elbow, wrist]| motion.bend(pose, elbow, wrist) > FOLDED),
            wrist_in_head: share(&|(places, turns), [_, wrist]| {
                let centre = places[HEAD] + turns[HEAD] * DVec3::Y * HEAD_SIZE.1;
                (places[wrist] - centre).length() < HEAD_SIZE.0
            }),
            half_rate_error: 100.0 * motion.half_rate_error(&poses),
            channel_jump: motion.channel_jump,
        }
    }
}

impl SkeletalMotion {
    fn pose(&self, root: DVec3, local: &[DQuat; JOINTS]) -> World {
        let (mut places, mut turns) = ([root; JOINTS], *local);
        for joint in 1..JOINTS {
            let parent = self.parents[joint];
            places[joint] = places[parent] + turns[parent] * self.offsets[joint];
            turns[joint] = (turns[parent] * local[joint]).normalize();
        }
        (places, turns)
    }

    /// Returns the speed with which a forearm turns about itself against the chest, degrees a
    /// second.
    fn twist(&self, before: &World, now: &World, elbow: usize, wrist: usize) -> f64 {
        let against_chest = |turns: &[DQuat; JOINTS]| turns[CHEST].inverse() * turns[elbow];
        let step = against_chest(&before.1).inverse() * against_chest(&now.1);
        let along = self.offsets[wrist].normalize_or_zero();
        let step = if step.w < 0.0 { -step } else { step };
        let angle = 2.0 * step.xyz().dot(along).atan2(step.w);
        angle.to_degrees() * FRAMES_PER_SECOND
    }

    /// Returns the angle between upper arm and forearm, degrees: 0 for a straight arm.
    fn bend(&self, (places, _): &World, elbow: usize, wrist: usize) -> f64 {
        let upper = places[elbow] - places[self.parents[elbow]];
        upper.angle_between(places[wrist] - places[elbow]).to_degrees()
    }

    /// Returns the height of the lowest point of both soles, metres.
    fn lowest(&self, (places, turns): &World) -> f64 {
        let feet = [[L_ANKLE, L_TOES], [R_ANKLE, R_TOES]].map(|[ankle, ball]| {
            let offset = self.offsets[ball];
            let ahead = offset.with_y(0.0);
            let heel = DVec3::Y * (offset.y - SOLE) - HEEL * ahead;
            let toes = TOES * ahead - DVec3::Y * SOLE;
            let heel = places[ankle].y + (turns[ankle] * heel).y;
            let tip = places[ball].y + (turns[ball] * toes).y;
            heel.min(tip).min(places[ball].y - SOLE)
        });
        feet[0].min(feet[1])
    }

    /// Returns the largest distance of a joint in every other frame from where the frames around it
    /// interpolate to, metres.
    fn half_rate_error(&self, poses: &[World]) -> f64 {
        let mut largest = 0.0_f64;
        for frame in (1..poses.len().saturating_sub(1)).step_by(2) {
            let (before, after) = (&self.local[frame - 1], &self.local[frame + 1]);
            let between: [DQuat; JOINTS] =
                std::array::from_fn(|joint| before[joint].slerp(after[joint], 0.5));
            let root = 0.5 * (self.root[frame - 1] + self.root[frame + 1]);
            let (places, _) = self.pose(root, &between);
            let pairs = places.iter().zip(&poses[frame].0);
            largest = pairs.map(|(a, b)| (*a - *b).length()).fold(largest, f64::max);
        }
        largest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{body::joint::NECK, testing::within};

    /// A body in its rest pose whose arms stretch along x and whose feet stand, moved by `pose`.
    fn motion(frames: usize, pose: impl Fn(f64, &mut [DQuat; JOINTS])) -> SkeletalMotion {
        let mut parents = [0; JOINTS];
        let mut offsets = [DVec3::ZERO; JOINTS];
        for (joint, parent, offset) in [
            (L_ANKLE, 0, DVec3::new(0.1, -0.925, 0.0)),
            (R_ANKLE, 0, DVec3::new(-0.1, -0.925, 0.0)),
            (L_TOES, L_ANKLE, DVec3::new(0.0, -0.06, 0.12)),
            (R_TOES, R_ANKLE, DVec3::new(0.0, -0.06, 0.12)),
            (CHEST, 0, DVec3::Y * 0.4),
            (NECK, CHEST, DVec3::Y * 0.1),
            (HEAD, NECK, DVec3::Y * 0.1),
            (L_ELBOW, CHEST, DVec3::X * 0.3),
            (L_WRIST, L_ELBOW, DVec3::X * 0.25),
            (R_ELBOW, CHEST, DVec3::X * -0.3),
            (R_WRIST, R_ELBOW, DVec3::X * -0.25),
        ] {
            (parents[joint], offsets[joint]) = (parent, offset);
        }
        let local = (0..frames).map(|frame| {
            let mut rotations = [DQuat::IDENTITY; JOINTS];
            pose(frame as f64 / FRAMES_PER_SECOND, &mut rotations);
            rotations
        });
        let root = vec![DVec3::Y; frames];
        SkeletalMotion { parents, offsets, root, local: local.collect(), channel_jump: 0.0 }
    }

    #[test]
    fn feet_at_rest_stand_on_the_floor_and_toes_that_dip_are_below() {
        let standing = SkeletalQuality::new(&motion(3, |_, _| {}));
        within(1e-9, standing.lowest_foot, 0.0);
        // Half of 12 cm, turned down by 30 degrees, and the sole below it.
        let dipped =
            motion(3, |_, pose| pose[L_TOES] = DQuat::from_rotation_x(30_f64.to_radians()));
        let (sin, cos) = 30_f64.to_radians().sin_cos();
        within(1e-9, SkeletalQuality::new(&dipped).lowest_foot, 1.5 - 6.0 * sin - 1.5 * cos);
    }

    #[test]
    fn a_twist_counts_against_the_chest_and_about_the_forearm() {
        let turning = |joint: usize, axis: DVec3, degrees: f64| {
            let moved = motion(61, |t, pose| {
                pose[joint] = DQuat::from_axis_angle(axis, (degrees * t).to_radians());
            });
            SkeletalQuality::new(&moved).fast_twist
        };
        within(1e-9, turning(L_ELBOW, DVec3::X, 400.0), 0.5);
        within(1e-9, turning(L_ELBOW, DVec3::X, 300.0), 0.0);
        within(1e-9, turning(L_ELBOW, DVec3::Y, 400.0), 0.0);
        within(1e-9, turning(0, DVec3::X, 400.0), 0.0);
    }

    #[test]
    fn folded_elbows_and_wrists_in_the_head_are_shares_of_both_arms() {
        let folded = |degrees: f64| {
            let fold = DQuat::from_rotation_y(-degrees.to_radians());
            motion(10, move |_, pose| pose[L_ELBOW] = fold)
        };
        // The fixture's elbow hangs on the chest: its upper arm is as long as the offset.
        within(1e-9, SkeletalQuality::new(&folded(160.0)).folded_elbows, 0.5);
        within(1e-9, SkeletalQuality::new(&folded(140.0)).folded_elbows, 0.0);
        let mut inside = motion(10, |_, _| {});
        inside.offsets[L_WRIST] = DVec3::new(-0.3, 0.25, 0.05);
        within(1e-9, SkeletalQuality::new(&inside).wrist_in_head, 0.5);
    }

    #[test]
    fn half_the_rate_loses_what_is_faster() {
        // One frame of 0.1 radians: the wrist is 0.55 m from the chest.
        let twitch = motion(5, |t, pose| {
            let angle = if (t * FRAMES_PER_SECOND - 1.0).abs() < 0.5 { 0.1 } else { 0.0 };
            pose[CHEST] = DQuat::from_rotation_y(angle);
        });
        let arc = 2.0 * (0.05_f64).sin() * 55.0;
        within(1e-6, SkeletalQuality::new(&twitch).half_rate_error, arc);
        let steady = motion(9, |t, pose| pose[CHEST] = DQuat::from_rotation_y(3.0 * t));
        within(1e-9, SkeletalQuality::new(&steady).half_rate_error, 0.0);
    }
}
