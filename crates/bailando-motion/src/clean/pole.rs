//! Upper arms that pass a pole of their angles, turned about themselves by a few degrees.
//!
//! BVH and FBX write an upper arm as angles about z, x and y, in that order. Where its y axis
//! points along its parent's z, the first and the last of them turn about one axis and can jump by
//! half a turn from one frame to the next. No order is without such a pole, and an arm goes
//! everywhere. A turn of the upper arm about itself leads past it and moves no joint; the forearm
//! turns back and stays as it was.

use std::{
    collections::VecDeque,
    f64::consts::{PI, TAU},
};

use glam::{DMat3, DQuat, DVec3, Quat};

use crate::{
    animation::{Animation, FrameQueue},
    skeleton::Skeleton,
    smooth::smooth_step,
};

/// Largest step of an angle from one frame to the next that is left as it is, radians: somewhat
/// less than the 30 degrees that animators accept, for not every pass comes down to it.
const STEP: f64 = 26.0 / 360.0 * TAU;
/// Sine of the middle angle below which no arm is so fast that another angle makes such a step.
const FAR: f64 = 0.7;
/// Seconds over which an arm turns aside before a pole, and back after it.
const ASIDE: f64 = 0.165;
/// Turns that are tried: so many on either side, of so many radians.
const TRIED: (i16, f64) = (10, 3.0 / 360.0 * TAU);
/// Furthest that an arm is turned by all of its passes together, radians: one that lingers at its
/// pole passes it again and again.
const FURTHEST: f64 = 60.0 / 360.0 * TAU;

/// Leads the arms of one motion past their poles.
#[derive(Clone, Debug)]
pub(super) struct PoleDetour {
    arms: Vec<Arm>,
    half_width: usize,
    continues: bool,
    /// Turns in the order in which they are tried: that of the pass itself and that of the middle
    /// of either half, which has the other direction before it than after it.
    tried: Vec<[f64; 2]>,
    frames: Animation,
    /// How far the arms of `frames` are turned, radians.
    turned: VecDeque<[f64; 2]>,
    /// Steps of `frames` that need no more looking at.
    seen: usize,
    /// Number of frames released.
    done: usize,
}

#[derive(Clone, Copy, Debug)]
struct Arm {
    joints: [usize; 2],
    /// Unit vector along the upper arm in the rest pose.
    bone: DVec3,
    /// From the T-pose, which some skeletons rest in, to the rest pose.
    from_t_pose: DQuat,
}

impl PoleDetour {
    /// For a motion at `fps`, whose first frame stays as it is if it continues another.
    pub(super) fn new(skeleton: &Skeleton, fps: u32, continues: bool) -> Self {
        let sides = [("l_shoulder", "l_elbow", DVec3::X), ("r_shoulder", "r_elbow", DVec3::NEG_X)];
        let arms = sides.into_iter().filter_map(|(upper, lower, out)| {
            let named = |name: &str| skeleton.joints.iter().position(|joint| joint == name);
            let joints = [named(upper)?, named(lower)?];
            let bone = skeleton.offset(joints[1]).as_dvec3().try_normalize()?;
            (skeleton.parent(joints[1]) == Some(joints[0])).then_some(())?;
            Some(Arm { joints, bone, from_t_pose: DQuat::from_rotation_arc(out, bone) })
        });
        let (most, turn) = TRIED;
        let turns = || (-most..=most).map(|times| f64::from(times) * turn);
        let pairs = turns().flat_map(|pass| turns().map(move |sides| [pass, sides]));
        let mut tried: Vec<[f64; 2]> = pairs.collect();
        tried.sort_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])));
        Self {
            arms: arms.collect(),
            half_width: (ASIDE * f64::from(fps)).round() as usize,
            continues,
            tried,
            frames: Animation::empty(fps),
            turned: VecDeque::new(),
            seen: 0,
            done: 0,
        }
    }

    /// Takes the next frames; returns those that are settled.
    pub(super) fn push(&mut self, animation: Animation) -> Animation {
        self.frames.push_frames(animation);
        self.turned.resize(self.frames.root.len(), [0.0; 2]);
        // A pass is looked at with all frames that it may change, its fastest step being one of
        // three.
        let known = self.frames.root.len().saturating_sub(self.half_width + 4);
        self.look(known);
        self.release(self.seen.saturating_sub(self.half_width))
    }

    /// Returns the rest.
    pub(super) fn end(&mut self) -> Animation {
        self.look(self.frames.root.len().saturating_sub(1));
        self.release(self.frames.root.len())
    }

    fn release(&mut self, count: usize) -> Animation {
        self.seen = self.seen.saturating_sub(count);
        self.done += count;
        self.turned.drain(..count);
        self.frames.take_frames(count)
    }

    /// Looks at the steps up to `known`, in order.
    fn look(&mut self, known: usize) {
        while self.seen < known {
            for side in 0..self.arms.len() {
                if self.jumps(self.arms[side], self.seen) {
                    self.lead(side, self.seen);
                }
            }
            self.seen += 1;
        }
    }

    /// Whether an angle of an arm jumps in the step from `frame` and the arm itself does not.
    fn jumps(&self, arm: Arm, frame: usize) -> bool {
        let pose = |frame: usize| self.frames.rotations[frame][arm.joints[0]].as_dquat();
        let turns = [pose(frame), pose(frame + 1)];
        turns.iter().any(|&turn| (turn * DVec3::Y).z.abs() > FAR)
            && arm.step(turns, STEP) > STEP
            && turns[0].angle_between(turns[1]) < STEP
    }

    /// Leads the arm of a side past the pole that it passes in the step from `frame` or the two
    /// after it.
    fn lead(&mut self, side: usize, frame: usize) {
        let arm = self.arms[side];
        let turns = self.turns(arm, frame..frame + 4);
        let steps = || turns.windows(2).map(|pair| arm.step([pair[0], pair[1]], TAU));
        let fastest = steps().enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b));
        let pass = frame + fastest.map_or(0, |(step, _)| step);
        let frames = pass.saturating_sub(self.half_width)
            ..self.frames.root.len().min(pass + self.half_width + 2);
        let shapes: Vec<[f64; 2]> = frames.clone().map(|at| self.shape(pass, at)).collect();
        let turns = self.turns(arm, frames.clone());
        let aside = |frame: usize, [pass, sides]: [f64; 2]| -> f64 {
            shapes[frame][0] * pass + shapes[frame][1] * sides
        };
        let mut best = ([0.0; 2], f64::MAX);
        let before: Vec<f64> = frames.clone().map(|at| self.turned[at][side]).collect();
        let too_far = |tried: [f64; 2]| {
            before.iter().enumerate().any(|(at, before)| {
                let aside = aside(at, tried);
                aside != 0.0 && (before + aside).abs() > FURTHEST
            })
        };
        for &tried in &self.tried {
            if too_far(tried) {
                continue;
            }
            let turned = |frame: usize| arm.twisted(turns[frame], aside(frame, tried));
            let mut worst = 0.0_f64;
            for frame in 1..turns.len() {
                worst = worst.max(arm.step([turned(frame - 1), turned(frame)], best.1));
                if worst >= best.1 {
                    break;
                }
            }
            if worst < best.1 {
                best = (tried, worst);
            }
            if worst <= STEP {
                break;
            }
        }
        for (at, frame) in frames.enumerate() {
            let [upper, lower] = arm.joints;
            let aside = aside(at, best.0);
            self.turned[frame][side] += aside;
            let twist = DQuat::from_axis_angle(arm.bone, aside);
            let pose = &mut self.frames.rotations[frame];
            pose[upper] = twisted_by(pose[upper], DQuat::IDENTITY, twist);
            pose[lower] = twisted_by(pose[lower], twist.inverse(), DQuat::IDENTITY);
        }
    }

    /// Returns how much of a turn of the pass, and of the sides, a frame takes.
    fn shape(&self, pass: usize, frame: usize) -> [f64; 2] {
        let from_pass = frame as f64 - pass as f64 - 0.5;
        let part = from_pass / (self.half_width as f64 + 0.5);
        let mut near = (0.5 * PI * part.clamp(-1.0, 1.0)).cos().powi(2);
        if self.continues {
            near *= smooth_step((self.done + frame) as f64 / self.half_width as f64);
        }
        // 0.65 is the most of this product.
        [near, -(PI * part).sin() * near / 0.65]
    }

    fn turns(&self, arm: Arm, frames: std::ops::Range<usize>) -> Vec<DQuat> {
        let poses = self.frames.rotations.iter().take(frames.end).skip(frames.start);
        poses.map(|pose| pose[arm.joints[0]].as_dquat()).collect()
    }
}

impl Arm {
    /// Returns `turn` with the upper arm turned about itself.
    fn twisted(self, turn: DQuat, angle: f64) -> DQuat {
        turn * DQuat::from_axis_angle(self.bone, angle)
    }

    /// Returns the largest step of an angle between two frames, radians, on the motion's own
    /// skeleton and on those that rest in a T-pose; the second is not asked once the first is above
    /// `enough`.
    fn step(self, turns: [DQuat; 2], enough: f64) -> f64 {
        let own = largest_step(turns);
        if own > enough { own } else { own.max(largest_step(turns.map(|t| t * self.from_t_pose))) }
    }
}

fn twisted_by(rotation: Quat, before: DQuat, after: DQuat) -> Quat {
    (before * rotation.as_dquat() * after).as_quat().normalize()
}

/// Returns the angles about z, x and y whose rotations, in this order, make up `turn`, radians.
fn angles(turn: DQuat) -> [f64; 3] {
    let [x, y, z] = DMat3::from_quat(turn).transpose().to_cols_array_2d();
    [(-x[1]).atan2(y[1]), z[1].atan2(z[0].hypot(z[2])), (-z[0]).atan2(z[2])]
}

/// Returns the largest change of an angle between two rotations. Every rotation has two sets of
/// angles; that nearest to the former ones is written.
fn largest_step(turns: [DQuat; 2]) -> f64 {
    let [before, [a, b, c]] = turns.map(angles);
    let steps = [[a, b, c], [a + PI, PI - b, c + PI]].map(|now| {
        let step = |k: usize| ((now[k] - before[k] + PI).rem_euclid(TAU) - PI).abs();
        DVec3::new(step(0), step(1), step(2))
    });
    let [one, other] = steps;
    let nearest = if one.length_squared() <= other.length_squared() { one } else { other };
    nearest.max_element()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::forward;

    /// A left arm whose forearm swings in while its y axis passes the parent's z at `beside` from
    /// it, both in radians, and swings back.
    fn passing(beside: f64, twist: f64) -> Animation {
        let pose = |frame: usize| {
            let t = frame as f64 / 60.0;
            let mut pose = vec![Quat::IDENTITY; 24];
            let pass = DQuat::from_rotation_z(beside + 0.3 * (t - 1.0));
            let arm = pass * DQuat::from_rotation_x(0.5 * PI + twist * (3.0 * (t - 1.0)).sin());
            (pose[16], pose[18]) = (arm.as_quat(), Quat::from_rotation_y(-1.8));
            pose
        };
        let root = vec![glam::Vec3::Y; 120];
        Animation { fps: 60, root, rotations: (0..120).map(pose).collect() }
    }

    fn led(animation: &Animation, piece: usize, continues: bool) -> Animation {
        let mut detour = PoleDetour::new(&Skeleton::fixture(), 60, continues);
        let (mut rest, mut done) = (animation.clone(), Animation::empty(60));
        while !rest.root.is_empty() {
            let count = piece.min(rest.root.len());
            done.push_frames(detour.push(rest.take_frames(count)));
        }
        done.push_frames(detour.end());
        done
    }

    fn worst(animation: &Animation) -> f64 {
        let detour = PoleDetour::new(&Skeleton::fixture(), 60, false);
        let turns: Vec<_> = animation.rotations.iter().map(|pose| pose[16].as_dquat()).collect();
        let steps = turns.windows(2).map(|pair| detour.arms[0].step([pair[0], pair[1]], TAU));
        steps.fold(0.0, f64::max).to_degrees()
    }

    #[test]
    fn an_arm_passes_its_pole_without_a_jump_and_no_joint_moves() {
        let skeleton = Skeleton::fixture();
        for (beside, twist) in [(0.02, 0.8), (0.05, 1.5)] {
            let before = passing(beside, twist);
            let after = led(&before, 7, false);
            let (jump, left) = (worst(&before), worst(&after));
            assert!(jump > 30.0 && left < 30.0, "{beside}, {twist}: {jump} to {left} degrees");
            for piece in [1, 50, 120] {
                assert_eq!(led(&before, piece, false), after);
            }
            let [was, is] = [&before, &after].map(|motion| forward(&skeleton, motion).unwrap());
            let moved = was.iter().zip(&is).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(moved < 1e-5, "{moved} m");
        }
    }

    #[test]
    fn an_arm_that_lingers_at_its_pole_is_not_turned_ever_further() {
        // It passes to and fro, twelve times a second.
        let mut lingers = passing(0.05, 1.5);
        for (frame, pose) in lingers.rotations.iter_mut().enumerate() {
            let sway = 0.4 * (TAU * 6.0 * frame as f64 / 60.0).sin();
            let arm = DQuat::from_rotation_z(0.05) * DQuat::from_rotation_x(0.5 * PI + sway);
            pose[16] = arm.as_quat();
        }
        let after = led(&lingers, 7, false);
        let turned = lingers.rotations.iter().zip(&after.rotations);
        let turned = turned.map(|(was, is)| was[16].angle_between(is[16]));
        let most = f64::from(turned.fold(0.0, f32::max));
        assert!(most > 0.05 && most < FURTHEST + 1e-3, "{} degrees", most.to_degrees());
    }

    #[test]
    fn other_motion_stays_as_it_is_and_so_does_the_first_frame_of_a_continuation() {
        // The arm hangs away from its pole and swings as fast.
        let mut far = passing(0.05, 1.5);
        for pose in &mut far.rotations {
            pose[16] = Quat::from_rotation_z(-1.2) * pose[16] * Quat::from_rotation_x(-1.5);
        }
        assert!(worst(&far) < 26.0);
        assert_eq!(led(&far, 9, false), far);
        let mut near = passing(0.02, 0.8);
        near.take_frames(58);
        let after = led(&near, 9, true);
        assert_ne!(after, near);
        assert_eq!(after.rotations[0], near.rotations[0]);
    }
}
