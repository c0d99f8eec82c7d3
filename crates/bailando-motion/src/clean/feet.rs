//! Feet: contacts held in place, soles above the floor, toes that bend, legs that reach.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3, Quat};

use super::{
    contact::{BALL, Contacts, HEEL, Hold},
    foot::{Foot, above_floor, height},
    limb::Limb,
    pose::WorldPose,
};
use crate::{
    animation::{Animation, FrameQueue},
    skeleton::Skeleton,
    smooth::{smooth_step, smooth_upper_bound_at},
};

/// The root is never lowered further than this, metres.
const MOST_LOWERED: f64 = 0.08;
/// Seconds that lowering the root starts before it is needed and ends after.
const LOWERING: f64 = 0.15;
/// Toes that leave the floor straighten no faster than this, radians a second: 20 degrees a frame
/// at 60 fps.
const STRAIGHTENING: f64 = 1200.0 / 360.0 * TAU;

/// Plants the feet of one motion.
#[derive(Clone, Debug)]
pub(crate) struct FeetPlanter {
    pose: WorldPose,
    legs: Vec<Leg>,
    half_width: usize,
    lookahead: usize,
    continues: bool,
    flat: bool,
    frames: Animation,
    /// Number of frames released.
    done: usize,
    /// How much lower the root must be, in every frame whose feet are known, metres.
    missing: Vec<f64>,
    last: Vec<Quat>,
}

#[derive(Clone, Debug)]
struct Leg {
    limb: Limb,
    foot: Foot,
    heel: Contacts,
    ball: Contacts,
    /// Most by which the toes straighten in a frame, radians.
    straightening: f64,
    /// Where the foot goes, in every frame that is settled.
    targets: Vec<Target>,
}

/// A foot in world space.
#[derive(Clone, Copy, Debug)]
struct Target {
    ankle: DVec3,
    turn: DQuat,
    toe_bend: f64,
    /// Share of its length to which the leg was extended before.
    extension: f64,
}

impl FeetPlanter {
    pub(crate) fn new(skeleton: &Skeleton, fps: u32, continues: bool) -> Self {
        let leg = |ball| {
            Some(Leg {
                limb: Limb::above(skeleton, ball, DVec3::NEG_Z)?,
                foot: Foot::of(skeleton, ball)?,
                heel: Contacts::new(&HEEL, fps, continues),
                ball: Contacts::new(&BALL, fps, continues),
                straightening: STRAIGHTENING / f64::from(fps),
                targets: Vec::new(),
            })
        };
        let feet = skeleton.foot_joints();
        Self {
            pose: WorldPose::new(skeleton).only(&feet),
            legs: feet.into_iter().filter_map(leg).collect(),
            half_width: (LOWERING * f64::from(fps)).ceil() as usize,
            lookahead: Contacts::new(&BALL, fps, continues).lookahead(),
            continues,
            flat: false,
            frames: Animation::empty(fps),
            done: 0,
            missing: Vec::new(),
            last: Vec::new(),
        }
    }

    /// For a figure with soles of its own: takes the roll from feet near the floor, too, so that
    /// they stand flat on it; `toes` are lengths of toes in the order of the skeleton's foot
    /// joints, `sag` is how far a skin comes below bent ones, both in metres.
    pub(crate) fn with_soles(mut self, toes: [f64; 2], sag: f64) -> Self {
        for (leg, length) in self.legs.iter_mut().zip(toes) {
            leg.foot = leg.foot.with_toes(length, sag);
        }
        Self { flat: true, ..self }
    }

    /// Takes the next frames; returns those that are settled.
    pub(crate) fn push(&mut self, mut animation: Animation) -> Animation {
        for (root, rotations) in animation.root.iter().zip(&mut animation.rotations) {
            self.pose.set(*root, rotations);
            if self.flat {
                self.legs.iter().for_each(|leg| leg.level(&self.pose, rotations));
                self.pose.set(*root, rotations);
            }
            for leg in &mut self.legs {
                let [heel, ball] = leg.points(&self.pose);
                leg.heel.push(heel);
                leg.ball.push(ball);
            }
        }
        self.frames.push_frames(animation);
        let known = self.done + self.frames.root.len();
        self.settle(known.saturating_sub(self.lookahead));
        self.release(self.missing.len().saturating_sub(2 * self.half_width))
    }

    /// Returns the rest.
    pub(crate) fn end(&mut self) -> Animation {
        for leg in &mut self.legs {
            leg.heel.end();
            leg.ball.end();
        }
        let known = self.done + self.frames.root.len();
        self.settle(known);
        self.release(known)
    }

    /// Finds where the feet go up to the frame `end`.
    fn settle(&mut self, end: usize) {
        for frame in self.missing.len()..end {
            let here = frame - self.done;
            self.pose.set(self.frames.root[here], &self.frames.rotations[here]);
            let mut missing = 0.0_f64;
            for leg in &mut self.legs {
                let ball = leg.limb.joints[3];
                let toes = self.continues.then(|| self.frames.rotations[here][ball]);
                missing = missing.max(leg.settle(frame, &self.pose, self.flat, toes));
            }
            self.missing.push(missing.min(MOST_LOWERED));
        }
    }

    fn release(&mut self, end: usize) -> Animation {
        let count = end.saturating_sub(self.done);
        let mut animation = self.frames.take_frames(count);
        for (root, rotations) in animation.root.iter_mut().zip(&mut animation.rotations) {
            let mut lowered = smooth_upper_bound_at(&self.missing, self.half_width, self.done);
            if self.continues {
                lowered *= smooth_step(self.done as f64 / self.half_width as f64);
            }
            root.y -= lowered as f32;
            self.pose.set(*root, rotations);
            for leg in &self.legs {
                leg.write(self.done, &self.pose, rotations);
            }
            for (rotation, last) in rotations.iter_mut().zip(&self.last) {
                if rotation.dot(*last) < 0.0 {
                    *rotation = -*rotation;
                }
            }
            self.last.clone_from(rotations);
            self.done += 1;
        }
        animation
    }
}

impl Leg {
    /// Takes the roll from the foot of `pose` near the floor; ankle and ball stay.
    fn level(&self, pose: &WorldPose, rotations: &mut [Quat]) {
        let [_, _, ankle, ball] = self.limb.joints;
        let turn = pose.turn(ankle);
        let line = (turn * self.foot.ball).normalize();
        let turn = self.foot.levelled(turn, line, self.foot.clearance(pose.place(ball), turn));
        rotations[ankle] = (pose.turn_above(ankle).inverse() * turn).as_quat().normalize();
    }

    /// Returns heel and ball of a pose.
    fn points(&self, pose: &WorldPose) -> [DVec3; 2] {
        let ankle = self.limb.joints[2];
        let (place, turn) = (pose.place(ankle), pose.turn(ankle));
        [place + turn * self.foot.heel, place + turn * self.foot.ball]
    }

    /// Finds where the foot goes in `frame`; returns how much lower the root must be for it. Before
    /// the first frame of a motion that continues another, the toes are bent as `toes` says.
    fn settle(&mut self, frame: usize, pose: &WorldPose, flat: bool, toes: Option<Quat>) -> f64 {
        let [heel, ball] = self.points(pose);
        let holds = [self.heel.at(frame), self.ball.at(frame)];
        let [heel_to, ball_to] = [(heel, holds[0]), (ball, holds[1])].map(held);
        // The ball is exact where both stand: the heel turns about it.
        let [by_heel, by_ball] = holds.map(|hold| hold.weight);
        let share = (by_ball + 0.05) / (by_ball + by_heel * (1.0 - by_ball) + 0.1);
        let turn = pose.turn(self.limb.joints[2]);
        let turn = match (ball - heel).try_normalize() {
            Some(from) => {
                let to = self.foot.slanted(ball_to - heel_to);
                let turn = (DQuat::from_rotation_arc(from, to) * turn).normalize();
                match flat {
                    // Contacts have brought the sole nearer to the floor.
                    true => self.foot.levelled(turn, to, self.foot.clearance(ball_to, turn)),
                    false => turn,
                }
            }
            None => turn,
        };
        let pivot = self.foot.heel.lerp(self.foot.ball, share);
        let ankle = heel_to.lerp(ball_to, share) - turn * pivot;
        let bent = match self.targets.last() {
            Some(before) => before.toe_bend,
            None => toes.map_or(0.0, |toes| self.foot.bend_of(toes)),
        };
        let ball = ankle + turn * self.foot.ball;
        let (toe_bend, lift) = self.foot.toe_bend(ball, turn, bent - self.straightening);
        let ankle = ankle + DVec3::Y * lift;
        let [hip, _, joint, _] = self.limb.joints;
        let full = self.limb.distance_at(0.0);
        let extension = (pose.place(joint) - pose.place(hip)).length() / full;
        self.targets.push(Target { ankle, turn, toe_bend, extension });

        // A standing leg is never stretched to reach its foot: the root is lowered instead.
        let line = ankle - pose.place(hip);
        let missing = (line.length() - self.limb.bones.free(extension)).max(0.0);
        by_heel.max(by_ball) * missing / (-line.normalize_or_zero().y).max(0.5)
    }

    /// Bends the leg of `pose` to where its foot goes in `frame`.
    fn write(&self, frame: usize, pose: &WorldPose, rotations: &mut [Quat]) {
        let Target { ankle, turn, toe_bend, extension } = self.targets[frame];
        let [hip, _, _, ball] = self.limb.joints;
        let line = ankle - pose.place(hip);
        let reached = self.limb.bones.reach(line.length(), extension);
        let line = line.normalize_or(DVec3::NEG_Y) * reached;
        let [thigh, shank] = self.limb.reach(line, self.limb.axis(pose.turn(hip)));
        self.limb.write(pose, [thigh, shank, turn], rotations);
        rotations[ball] = self.foot.toes_bent(toe_bend).as_quat().normalize();
    }
}

/// Returns where a point of the sole goes: held by its contacts, else above the floor.
fn held((point, hold): (DVec3, Hold)) -> DVec3 {
    let moved = point + hold.offset;
    let now = height(moved);
    // Between two contacts the path of the offset can dip.
    let wanted = (1.0 - hold.weight) * above_floor(now) + hold.weight * now.max(0.0);
    moved + DVec3::Y * (wanted - now)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stands on the balls of its feet for a second, and leaves the floor at 3 m/s.
    fn lifting(skeleton: &Skeleton) -> Animation {
        let mut pose = vec![Quat::IDENTITY; 24];
        for ankle in [7, 8] {
            pose[ankle] = Quat::from_rotation_x(0.9);
        }
        let mut world = WorldPose::new(skeleton);
        world.set(glam::Vec3::ZERO, &pose);
        let stands = -height(world.place(10)) as f32;
        let risen = |frame: usize| frame.saturating_sub(60) as f32 * 0.05;
        let root = |frame: usize| glam::Vec3::Y * (stands + risen(frame));
        Animation { fps: 60, root: (0..90).map(root).collect(), rotations: vec![pose; 90] }
    }

    #[test]
    fn toes_that_leave_the_floor_straighten_in_some_frames() {
        let skeleton = Skeleton::fixture();
        for continues in [false, true] {
            let mut planter = FeetPlanter::new(&skeleton, 60, continues);
            let mut done = planter.push(lifting(&skeleton));
            done.push_frames(planter.end());
            let foot = planter.legs[0].foot;
            let bends: Vec<f64> =
                done.rotations.iter().map(|pose| foot.bend_of(pose[10])).collect();
            assert!(bends[30] > 0.5, "on its toes: {}", bends[30]);
            assert_eq!(bends[89], 0.0);
            let most = bends.windows(2).map(|pair| pair[0] - pair[1]).fold(0.0, f64::max);
            assert!(most < STRAIGHTENING / 60.0 + 1e-4, "{} degrees a frame", most.to_degrees());
        }
    }

    #[test]
    fn a_motion_that_continues_another_has_its_bent_toes() {
        let skeleton = Skeleton::fixture();
        let mut hangs = lifting(&skeleton);
        let mut planter = FeetPlanter::new(&skeleton, 60, true);
        let foot = planter.legs[0].foot;
        hangs.take_frames(75);
        for pose in &mut hangs.rotations {
            pose[10] = foot.toes_bent(0.8).as_quat();
        }
        let mut done = planter.push(hangs);
        done.push_frames(planter.end());
        let first = foot.bend_of(done.rotations[0][10]);
        assert!((first - (0.8 - STRAIGHTENING / 60.0)).abs() < 1e-4, "{first}");
    }
}
