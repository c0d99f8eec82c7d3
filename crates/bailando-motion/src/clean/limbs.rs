//! Arms and legs: hinges that keep their axis, joints within their limits, hands outside the body.

use std::f64::consts::PI;

use glam::{DVec3, Quat};

use super::{capsule::Body, head::Head, hinge::HingeTracker, limb::Limb, pose::WorldPose};
use crate::{
    animation::{Animation, FrameQueue},
    skeleton::Skeleton,
    smooth::{smooth_step, smooth_upper_bound_at},
};

/// Elbows and knees bend freely up to the first of these and never beyond the second, radians.
const BEND: (f64, f64) = (130.0 / 180.0 * PI, 148.0 / 180.0 * PI);
/// Furthest turn of a knee's hinge from the front of the hip: a leg turned out.
const TURNED_OUT: f64 = 80.0 / 180.0 * PI;
/// Seconds over which a hand that must leave the body begins to move away before, and comes back
/// after.
const LEAVING: f64 = 0.1;

/// Cleans the limbs of one motion.
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
    half_width: usize,
    continues: bool,
    /// The way out of the body, in every frame so far, metres.
    ways_out: Vec<DVec3>,
    depths: Vec<f64>,
}

impl LimbCleaner {
    pub(super) fn new(skeleton: &Skeleton, fps: u32, continues: bool) -> Self {
        let named = |name: &str| skeleton.joints.iter().position(|joint| joint == name);
        let half_width = (LEAVING * f64::from(fps)).ceil() as usize;
        let arm = |hand| {
            Some(Arm {
                limb: Limb::above(skeleton, hand, DVec3::Z)?,
                hinge: HingeTracker::new(fps, PI, continues),
                half_width,
                continues,
                ways_out: Vec::new(),
                depths: Vec::new(),
            })
        };
        let leg = |foot| {
            let limb = Limb::above(skeleton, foot, DVec3::NEG_Z)?;
            Some((limb, HingeTracker::new(fps, TURNED_OUT, continues)))
        };
        let hands = ["l_hand", "r_hand"].into_iter().filter_map(named);
        let arms: Vec<Arm> = hands.filter_map(arm).collect();
        let hinge = HingeTracker::new(fps, PI, continues);
        Self {
            pose: WorldPose::new(skeleton),
            head: Head::of(skeleton),
            body: Body::of(skeleton),
            arms,
            legs: skeleton.foot_joints().into_iter().filter_map(leg).collect(),
            lookahead: hinge.lookahead().max(2 * half_width),
            frames: Animation::empty(fps),
            done: 0,
            last: Vec::new(),
        }
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
        let [_, _, wrist, hand] = self.limb.joints;
        let mut way = DVec3::ZERO;
        for capsule in body.iter().flat_map(|body| body.capsules(pose)) {
            // The hand may be out once the wrist is.
            way += capsule.way_out(pose.place(wrist) + way);
            way += capsule.way_out(pose.place(hand) + way);
        }
        self.ways_out.push(way);
        self.depths.push(way.length());
    }

    fn clean(&mut self, frame: usize, pose: &WorldPose, rotations: &mut [Quat]) {
        let axis = hinge_axis(&self.limb, &mut self.hinge, frame, pose);
        let [shoulder, _, wrist, _] = self.limb.joints;
        let wanted = pose.place(wrist) + self.way_out(frame);
        let line = within_limit(&self.limb, wanted - pose.place(shoulder));
        let [upper, lower] = self.limb.reach(line, axis);
        let pointing = self.limb.direction(2, pose.turn(wrist));
        let hand = self.limb.pointed(2, lower, pointing);
        self.limb.write(pose, [upper, lower, hand], rotations);
    }

    /// Returns how far the wrist moves in `frame`: all of the way out while the hand is inside, and
    /// some of it before and after.
    fn way_out(&self, frame: usize) -> DVec3 {
        let reach = 2 * self.half_width;
        let near = frame.saturating_sub(reach)..self.depths.len().min(frame + reach + 1);
        if self.depths[near.clone()].iter().all(|&depth| depth == 0.0) {
            return DVec3::ZERO;
        }
        let mut depth = smooth_upper_bound_at(&self.depths, self.half_width, frame);
        if self.continues {
            depth *= smooth_step(frame as f64 / self.half_width as f64);
        }
        let ways = near.map(|other| {
            let weight = (reach + 1 - other.abs_diff(frame)) as f64;
            self.ways_out[other] * weight * weight
        });
        ways.sum::<DVec3>().normalize_or_zero() * depth
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
        let mut cleaner = LimbCleaner::new(&Skeleton::fixture(), 60, false);
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
}
