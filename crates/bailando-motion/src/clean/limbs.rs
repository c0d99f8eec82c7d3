//! Arms and legs: hinges that keep their axis, joints within their limits, arms outside the body.

use std::f64::consts::PI;

use glam::{DVec3, Quat};

use super::{
    avoid::Avoidance, capsule::Body, head::Head, hinge::HingeTracker, limb::Limb, pose::WorldPose,
};
use crate::{
    animation::{Animation, FrameQueue},
    skeleton::Skeleton,
    smooth::smooth_step,
};

/// Elbows and knees bend freely up to the first of these and never beyond the second, radians.
const BEND: (f64, f64) = (130.0 / 180.0 * PI, 148.0 / 180.0 * PI);
/// Furthest turn of a knee's hinge from the front of the hip: a leg turned out.
const TURNED_OUT: f64 = 80.0 / 180.0 * PI;
/// Seconds on either side of a frame over which the line to the wrist of a folded arm is averaged:
/// a wrist at the shoulder has no direction of its own.
const FOLDED: f64 = 0.15;
/// Points of a forearm that stay outside of the body, shares of the way from elbow to wrist. The
/// wrist moves one nearer to the elbow hardly at all.
const FOREARM: [f64; 2] = [0.75, 0.5];

/// Cleans the arms and the head, or the legs, of one motion.
#[derive(Clone, Debug)]
pub(super) struct LimbCleaner {
    pose: WorldPose,
    head: Option<Head>,
    body: Option<Body>,
    arms: Vec<Arm>,
    legs: Vec<(Limb, HingeTracker)>,
    lookahead: usize,
    frames: Animation,
    /// Number of frames released.
    done: usize,
    /// Rotations of the frame released last.
    last: Vec<Quat>,
}

#[derive(Clone, Debug)]
struct Arm {
    limb: Limb,
    hinge: HingeTracker,
    avoidance: Avoidance,
    /// From the shoulder to the wrist in every frame so far, metres.
    lines: Vec<DVec3>,
    averaged: usize,
}

impl LimbCleaner {
    /// Cleans arms and head.
    pub(super) fn of_arms(skeleton: &Skeleton, fps: u32, continues: bool) -> Self {
        let named = |name: &str| skeleton.joints.iter().position(|joint| joint == name);
        let arm = |hand| {
            Some(Arm {
                limb: Limb::above(skeleton, hand, DVec3::Z)?,
                hinge: HingeTracker::new(fps, PI, continues),
                avoidance: Avoidance::new(fps, continues),
                lines: Vec::new(),
                averaged: (FOLDED * f64::from(fps)).round() as usize,
            })
        };
        let arms = ["l_hand", "r_hand"].into_iter().filter_map(named).filter_map(arm);
        let body = Body::of(skeleton);
        Self {
            head: Head::of(skeleton),
            body,
            arms: arms.collect(),
            lookahead: Avoidance::new(fps, continues).lookahead(),
            ..Self::of_none(skeleton, fps, continues)
        }
        .posed()
    }

    /// Cleans legs.
    pub(super) fn of_legs(skeleton: &Skeleton, fps: u32, continues: bool) -> Self {
        let leg = |foot| {
            let limb = Limb::above(skeleton, foot, DVec3::NEG_Z)?;
            Some((limb, HingeTracker::new(fps, TURNED_OUT, continues)))
        };
        let legs = skeleton.foot_joints().into_iter().filter_map(leg).collect();
        Self { legs, ..Self::of_none(skeleton, fps, continues) }.posed()
    }

    fn of_none(skeleton: &Skeleton, fps: u32, continues: bool) -> Self {
        Self {
            pose: WorldPose::new(skeleton),
            head: None,
            body: None,
            arms: Vec::new(),
            legs: Vec::new(),
            lookahead: HingeTracker::new(fps, PI, continues).lookahead(),
            frames: Animation::empty(fps),
            done: 0,
            last: Vec::new(),
        }
    }

    fn limbs(&self) -> impl Iterator<Item = &Limb> {
        self.arms.iter().map(|arm| &arm.limb).chain(self.legs.iter().map(|leg| &leg.0))
    }

    /// Poses no more joints than are looked at.
    fn posed(mut self) -> Self {
        let mut joints: Vec<usize> = self.limbs().flat_map(|limb| limb.joints).collect();
        joints.extend(self.body.iter().flat_map(|body| body.joints()));
        self.pose = self.pose.only(&joints);
        self
    }

    /// Returns the joints whose rotations it changes.
    pub(super) fn joints(&self) -> Vec<usize> {
        let joints = self
            .limbs()
            .flat_map(|Limb { joints: [upper, lower, end, _], .. }| [*upper, *lower, *end]);
        joints.chain(self.head.map(Head::joint)).collect()
    }

    /// Takes the next frames; returns those that are settled.
    pub(super) fn push(&mut self, mut animation: Animation) -> Animation {
        for (root, rotations) in animation.root.iter().zip(&mut animation.rotations) {
            if let Some(head) = self.head {
                head.level(rotations);
            }
            self.pose.set(*root, rotations);
            for arm in &mut self.arms {
                arm.see(&self.pose, self.body);
            }
            for (limb, hinge) in &mut self.legs {
                see(limb, hinge, &self.pose);
            }
        }
        self.frames.push_frames(animation);
        self.release(self.frames.root.len().saturating_sub(self.lookahead))
    }

    /// Returns the rest.
    pub(super) fn end(&mut self) -> Animation {
        self.release(self.frames.root.len())
    }

    fn release(&mut self, count: usize) -> Animation {
        let mut animation = self.frames.take_frames(count);
        for (root, rotations) in animation.root.iter().zip(&mut animation.rotations) {
            self.pose.set(*root, rotations);
            for arm in &mut self.arms {
                arm.clean(self.done, &self.pose, rotations);
            }
            for (limb, hinge) in &mut self.legs {
                let axis = hinge_axis(limb, hinge, self.done, &self.pose);
                let [upper, _, end, _] = limb.joints;
                let line = within_limit(limb, self.pose.place(end) - self.pose.place(upper));
                let [first, second] = limb.reach(line, axis);
                limb.write(&self.pose, [first, second, self.pose.turn(end)], rotations);
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

impl Arm {
    fn see(&mut self, pose: &WorldPose, body: Option<Body>) {
        see(&self.limb, &mut self.hinge, pose);
        let capsules = body.map(|body| body.capsules(pose));
        let [shoulder, elbow, wrist, hand] = self.limb.joints.map(|joint| pose.place(joint));
        self.lines.push(wrist - shoulder);
        let forearm = wrist - elbow;
        let [near, far] = FOREARM.map(|share| (elbow + forearm * share, share));
        let points = [(wrist, 1.0), (hand, 1.0), near, far];
        self.avoidance.see(points, forearm.normalize_or_zero(), capsules);
    }

    fn clean(&mut self, frame: usize, pose: &WorldPose, rotations: &mut [Quat]) {
        let axis = hinge_axis(&self.limb, &mut self.hinge, frame, pose);
        let [shoulder, _, wrist, _] = self.limb.joints;
        let wanted = pose.place(wrist) + self.avoidance.way_out(frame);
        let line = self.steadied(frame, wanted - pose.place(shoulder));
        // An arm is hardly stretched further than it was: next to its full length elbows pop.
        let extension = self.lines[frame].length() / self.limb.distance_at(0.0);
        let reached = self.limb.bones.reach(line.length(), extension);
        let line = within_limit(&self.limb, line.normalize_or(DVec3::NEG_Y) * reached);
        let [upper, lower] = self.limb.reach(line, axis);
        let pointing = self.limb.direction(2, pose.turn(wrist));
        let hand = self.limb.pointed(2, lower, pointing);
        self.limb.write(pose, [upper, lower, hand], rotations);
    }

    /// Returns the line from shoulder to wrist in `frame` with its length, and the further the arm
    /// was folded beyond its limit, with the direction of those around.
    fn steadied(&self, frame: usize, line: DVec3) -> DVec3 {
        let shortest = self.limb.distance_at(BEND.1);
        let share = smooth_step((shortest - self.lines[frame].length()) / (0.6 * shortest));
        if share == 0.0 {
            return line;
        }
        let reach = self.averaged;
        let near = frame.saturating_sub(reach)..self.lines.len().min(frame + reach + 1);
        let weighted =
            near.map(|other| self.lines[other] * (reach + 1 - other.abs_diff(frame)) as f64);
        let own = line.normalize_or_zero();
        let around = weighted.sum::<DVec3>().normalize_or(own);
        own.lerp(around, share).normalize_or(around) * line.length()
    }
}

fn see(limb: &Limb, hinge: &mut HingeTracker, pose: &WorldPose) {
    let [upper, lower, ..] = limb.joints.map(|joint| pose.turn(joint));
    hinge.see(limb.direction(0, upper), limb.direction(1, lower), limb.axis(upper));
}

fn hinge_axis(limb: &Limb, hinge: &mut HingeTracker, frame: usize, pose: &WorldPose) -> DVec3 {
    let upper = pose.turn(limb.joints[0]);
    hinge.at(frame, limb.direction(0, upper), limb.axis(upper))
}

/// Returns the line from the upper joint to the end of a limb, long enough that its hinge bends
/// within its limit; what is beyond the free range is compressed, so that nothing stops abruptly.
fn within_limit(limb: &Limb, line: DVec3) -> DVec3 {
    let (free, limit) = BEND;
    let distance = line.length();
    let (free_distance, full) = (limb.distance_at(free), limb.distance_at(0.0));
    if distance >= free_distance {
        return line.clamp_length_max(full);
    }
    let bones = limb.bones;
    let cos = (distance * distance - bones.thigh.powi(2) - bones.shank.powi(2))
        / (2.0 * bones.thigh * bones.shank);
    let beyond = cos.clamp(-1.0, 1.0).acos() - free;
    let range = limit - free;
    let bend = free + range * (1.0 - (-beyond / range).exp());
    line.normalize_or(DVec3::NEG_Y) * limb.distance_at(bend)
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    fn cleaned(animation: &Animation) -> Animation {
        let mut cleaner = LimbCleaner::of_arms(&Skeleton::fixture(), 60, false);
        let mut done = cleaner.push(animation.clone());
        done.push_frames(cleaner.end());
        done
    }

    /// The rest pose for two seconds, with one joint turned.
    fn turned(joint: usize, turn: impl Fn(f32) -> Quat) -> Animation {
        let pose = |frame: usize| {
            let mut pose = vec![Quat::IDENTITY; 24];
            pose[joint] = turn(frame as f32 / 60.0);
            pose
        };
        let root = vec![glam::Vec3::Y; 120];
        Animation { fps: 60, root, rotations: (0..120).map(pose).collect() }
    }

    fn bend(limb: &Limb, pose: &[Quat]) -> f64 {
        let lower = pose[limb.joints[1]].as_dquat();
        limb.direction(0, DQuat::IDENTITY).angle_between(limb.direction(1, lower))
    }

    #[test]
    fn limbs_bend_freely_up_to_their_limit() {
        let skeleton = Skeleton::fixture();
        let arm = Limb::above(&skeleton, 22, DVec3::Z).unwrap();
        for degrees in [20.0_f32, 90.0, 125.0, 140.0, 170.0] {
            let axis = arm.axis(DQuat::IDENTITY).as_vec3();
            let folded =
                turned(arm.joints[1], |_| Quat::from_axis_angle(axis, degrees.to_radians()));
            let (before, after) = (bend(&arm, &folded.rotations[60]), cleaned(&folded));
            let after = bend(&arm, &after.rotations[60]);
            match before < BEND.0 {
                true => assert!((after - before).abs() < 1e-3),
                false => assert!(after < before && after > BEND.0 - 1e-3 && after < BEND.1),
            }
        }
    }

    #[test]
    fn a_hand_that_passes_through_the_head_goes_around_it() {
        let skeleton = Skeleton::fixture();
        // The left arm turns up and inwards, and its forearm over to the right.
        let mut through = turned(16, |t| Quat::from_rotation_z(1.9 * t.min(1.0)));
        for (frame, pose) in through.rotations.iter_mut().enumerate() {
            pose[18] = Quat::from_rotation_z(1.9 * (frame as f32 / 60.0).min(1.0));
        }
        let body = Body::of(&skeleton).unwrap();
        let mut pose = WorldPose::new(&skeleton);
        let mut deepest = |animation: &Animation| {
            let frames = animation.root.iter().zip(&animation.rotations);
            let depths = frames.map(|(&root, rotations)| {
                pose.set(root, rotations);
                body.capsules(&pose)[0].way_out(pose.place(20)).length()
            });
            depths.fold(0.0, f64::max)
        };
        let after = cleaned(&through);
        let (before, after) = (deepest(&through), deepest(&after));
        assert!(before > 0.015 && after < 0.002, "{before} {after}");
    }

    /// The left forearm swings across the back, and the wrist passes the spine inside of the torso.
    fn across_the_back() -> Animation {
        let mut across = turned(18, |t| Quat::from_rotation_z(-2.0 * t.min(1.0)));
        for pose in &mut across.rotations {
            pose[16] = Quat::from_rotation_x(0.1) * Quat::from_rotation_z(-1.5);
        }
        across
    }

    /// Places of the left wrist, and the deepest that a point of the forearm or the hand is inside
    /// the body, metres.
    fn forearm(animation: &Animation) -> (Vec<DVec3>, f64) {
        let skeleton = Skeleton::fixture();
        let body = Body::of(&skeleton).unwrap();
        let mut pose = WorldPose::new(&skeleton);
        let (mut wrists, mut deepest) = (Vec::new(), 0.0_f64);
        for (&root, rotations) in animation.root.iter().zip(&animation.rotations) {
            pose.set(root, rotations);
            let [elbow, wrist, hand] = [18, 20, 22].map(|joint| pose.place(joint));
            let points = [0.5, 0.75, 1.0].map(|share| elbow.lerp(wrist, share));
            for capsule in body.capsules(&pose) {
                let depths = points.iter().chain([&hand]).map(|&p| capsule.way_out(p).length());
                deepest = depths.fold(deepest, f64::max);
            }
            wrists.push(wrist);
        }
        (wrists, deepest)
    }

    #[test]
    fn a_forearm_that_crosses_the_back_stays_outside_and_on_its_side() {
        let before = across_the_back();
        let ((_, inside), (wrists, left)) = (forearm(&before), forearm(&cleaned(&before)));
        assert!(inside > 0.04 && left < 0.01, "{inside} m to {left} m");
        let hardest = wrists.windows(3).map(|at| (at[2] - 2.0 * at[1] + at[0]).length());
        let hardest = hardest.fold(0.0, f64::max);
        assert!(hardest < 0.01, "{hardest} m a frame squared");
        assert!(wrists.iter().all(|wrist| wrist.z < 0.0), "it stays behind the back");
    }

    #[test]
    fn a_hand_at_the_side_stays_out_of_the_hips() {
        // The left arm hangs across, and the forearm is at the hip.
        let into = turned(16, |t| Quat::from_rotation_z(-1.8 * (2.0 * t).min(1.0)));
        let (_, inside) = forearm(&into);
        let (_, left) = forearm(&cleaned(&into));
        assert!(inside > 0.015 && left < 0.005, "{inside} m to {left} m");
    }
}
