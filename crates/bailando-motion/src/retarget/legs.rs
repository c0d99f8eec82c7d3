//! Legs of a figure on the dancer's steps: a skeleton of hips and legs alone, with the figure's
//! proportions and the dancer's size, bent by inverse kinematics and planted as the dancer's are.

use glam::{DQuat, DVec3, Quat};

use super::{
    figure::{BodyPart, Side},
    stance::LegRest,
    upper::{Dancer, correction},
};
use crate::{
    animation::{Animation, FrameQueue},
    clean::{feet::FeetPlanter, limb::Limb, pose::WorldPose},
    error::MotionError,
    floor::STANDING_HEIGHT,
    skeleton::Skeleton,
};

/// Joints of the skeleton: the hips, then hip, knee, ankle and ball of the left and the right.
const NAMES: [&str; 9] =
    ["hips", "l_hip", "l_knee", "l_ankle", "l_foot", "r_hip", "r_knee", "r_ankle", "r_foot"];
const PARENTS: [i32; 9] = [-1, 0, 1, 2, 3, 0, 5, 6, 7];
/// Distance from the ankle to the tip of a foot that shows no end, share of that to the ball.
const TIP: f64 = 1.5;
/// How far below its bones a skin that foot and toes share comes where toes are bent by a right
/// angle, share of the height of the ball: a MakeHuman figure's comes 8 mm below at 51 degrees.
const SAG: f64 = 0.5;
/// Balls are no higher above the sole than a dancer's, and so much, metres.
const MOST_RAISED: f64 = 0.05;

/// Plans for the legs of one figure.
#[derive(Clone, Debug)]
pub(super) struct LegRetargeter {
    skeleton: Skeleton,
    pelvis: usize,
    /// The middle of both hip joints from the hips, in the rest pose.
    middle: DVec3,
    /// How much higher the balls' joints stand than a dancer's, metres. The skeleton is lowered by
    /// as much, so that its feet roll over their own joints and contacts are found as a dancer's.
    raised: f64,
    legs: [Leg; 2],
}

#[derive(Clone, Debug)]
struct Leg {
    limb: Limb,
    /// The dancer's hip, knee, ankle and ball.
    followed: [usize; 4],
    /// Length of the dancer's leg, metres.
    full: f64,
    /// Turns of hip and foot from the figure's rest pose to the dancer's.
    corrections: [DQuat; 2],
    /// From the ankles to the points of both feet that are put together.
    points: [DVec3; 2],
    /// Length of the toes, metres.
    toes: f64,
}

/// A dance on its way to the figure's legs.
pub(super) struct Stepping {
    pose: WorldPose,
    animation: Animation,
}

/// World rotations of one frame: the hips, and hip, knee, ankle and ball of both legs.
pub(super) struct LegTurns([DQuat; 9]);

impl LegTurns {
    /// Returns the rotation of a part of hips or legs.
    pub(super) fn of(&self, part: BodyPart) -> Option<DQuat> {
        let (side, joint) = match part {
            BodyPart::Hips => return Some(self.0[0]),
            BodyPart::UpperLeg(side) => (side, 1),
            BodyPart::LowerLeg(side) => (side, 2),
            BodyPart::Foot(side) => (side, 3),
            BodyPart::Toes(side) => (side, 4),
            _ => return None,
        };
        Some(self.0[joint + 4 * side as usize])
    }
}

impl LegRetargeter {
    /// `hips` and `rest` are the figure's in the frame of dances.
    pub(super) fn new(
        dancer: &Skeleton,
        joints: &Dancer,
        hips: DVec3,
        rest: [LegRest; 2],
    ) -> Result<Self, MotionError> {
        let raised = 0.5 * rest.iter().map(raised).sum::<f64>();
        let mut offsets = vec![DVec3::ZERO];
        for (side, leg) in Side::BOTH.into_iter().zip(&rest) {
            let ball = dancer.offset(joints.side(side).leg[3]).as_dvec3();
            offsets.extend([leg.hip - hips, leg.knee - leg.hip, leg.ankle - leg.knee]);
            offsets.push(ball_of(leg, ball, raised));
        }
        let skeleton = Skeleton {
            joints: NAMES.map(String::from).to_vec(),
            parents: PARENTS.to_vec(),
            offsets: offsets.iter().map(|offset| offset.as_vec3().to_array()).collect(),
            root_height: (hips.y - raised) as f32,
        };
        skeleton.validate()?;
        let leg = |side: Side| Leg::new(&skeleton, dancer, joints, side, &rest[side as usize]);
        let legs = [leg(Side::Left)?, leg(Side::Right)?];
        let middle = 0.5 * (rest[0].hip + rest[1].hip) - hips;
        Ok(Self { pelvis: joints.pelvis(), middle, raised, legs, skeleton })
    }

    pub(super) fn start(&self, fps: u32) -> Stepping {
        Stepping { pose: WorldPose::new(&self.skeleton), animation: Animation::empty(fps) }
    }

    /// Takes the dancer's next pose: the hips' joints are where the dancer's are in the middle,
    /// the soles where the dancer's stand.
    pub(super) fn follow(&self, stepping: &mut Stepping, dancer: &WorldPose) {
        let turn = dancer.turn(self.pelvis);
        let hip = |leg: &Leg| dancer.place(leg.followed[0]);
        let middle = 0.5 * (hip(&self.legs[0]) + hip(&self.legs[1]));
        let root = (middle - turn * self.middle - DVec3::Y * self.raised).as_vec3();
        let mut rotations = vec![Quat::IDENTITY; NAMES.len()];
        rotations[0] = turn.as_quat().normalize();
        stepping.pose.set(root, &rotations);
        for leg in &self.legs {
            leg.follow(dancer, &stepping.pose, &mut rotations);
        }
        stepping.animation.root.push(root);
        stepping.animation.rotations.push(rotations);
    }

    fn sag(&self) -> f64 {
        SAG * (f64::from(STANDING_HEIGHT) + self.raised)
    }

    /// Returns place of the hips and rotations of the legs in every frame.
    pub(super) fn end(&self, stepping: Stepping, planted: bool) -> Vec<(DVec3, LegTurns)> {
        let Stepping { mut pose, animation } = stepping;
        let animation = match planted {
            true => {
                let planter = FeetPlanter::new(&self.skeleton, animation.fps, false);
                let [left, right] = &self.legs;
                let mut planter = planter.with_soles([left.toes, right.toes], self.sag());
                let mut done = planter.push(animation);
                done.push_frames(planter.end());
                done
            }
            false => animation,
        };
        let frames = animation.root.iter().zip(&animation.rotations);
        let turned = frames.map(|(root, rotations)| {
            pose.set(*root, rotations);
            let root = root.as_dvec3() + DVec3::Y * self.raised;
            (root, LegTurns(std::array::from_fn(|joint| pose.turn(joint))))
        });
        turned.collect()
    }
}

/// Returns how much higher the ball of a figure's foot rests than a dancer's.
fn raised(leg: &LegRest) -> f64 {
    let standing = f64::from(STANDING_HEIGHT);
    let ball = leg.ball.filter(|_| leg.has_toes);
    ball.map_or(0.0, |ball| (ball.y - standing).clamp(-standing, MOST_RAISED))
}

/// Returns the ball of a figure's foot from its ankle, `raised` above a dancer's; `own` is the
/// dancer's, for a foot that shows none.
fn ball_of(leg: &LegRest, own: DVec3, raised: f64) -> DVec3 {
    let own = own.with_y(0.0);
    let ahead = leg.ball.map(|ball| (ball - leg.ankle).with_y(0.0));
    let ahead = ahead.filter(|ahead| ahead.length() > 0.2 * own.length());
    let ahead = ahead.unwrap_or(if leg.has_toes { own } else { own * TIP });
    ahead.with_y(f64::from(STANDING_HEIGHT) + raised - leg.ankle.y)
}

/// Returns the length of the toes of a foot with this way along the floor from ankle to ball.
fn toes_of(leg: &LegRest, ahead: DVec3) -> f64 {
    let length = ahead.length();
    let shown = leg.tip.zip(leg.ball).map(|(tip, ball)| (tip - ball).dot(ahead / length));
    shown.filter(|shown| *shown > 0.2 * length).unwrap_or((TIP - 1.0) * length)
}

impl Leg {
    fn new(
        skeleton: &Skeleton,
        dancer: &Skeleton,
        joints: &Dancer,
        side: Side,
        rest: &LegRest,
    ) -> Result<Self, MotionError> {
        let ball = 4 + 4 * side as usize;
        let flat = || MotionError::Figure(format!("the {side:?} leg of its rest pose is no leg"));
        let limb = Limb::above(skeleton, ball, DVec3::NEG_Z).ok_or_else(flat)?;
        let followed = joints.side(side).leg;
        let [_, thigh, shank, foot] = followed.map(|joint| dancer.offset(joint).as_dvec3());
        let own = skeleton.offset(ball).as_dvec3();
        let [level, own_level] = [foot, own].map(|foot| foot.with_y(0.0));
        // Balls are put together; a foot without toes follows at the same distance from the ankle.
        let ahead = match rest.has_toes {
            true => [level, own_level],
            false => {
                let near = level.length().min(own_level.length());
                [level, own_level].map(|level| level.normalize_or_zero() * near)
            }
        };
        Ok(Self {
            limb,
            followed,
            full: thigh.length() + shank.length(),
            corrections: [correction(rest.knee - rest.hip, thigh), correction(own_level, level)],
            points: [ahead[0].with_y(foot.y), ahead[1].with_y(own.y)],
            toes: toes_of(rest, own_level),
        })
    }

    fn follow(&self, dancer: &WorldPose, pose: &WorldPose, rotations: &mut [Quat]) {
        let [hip, _, ankle, _] = self.followed;
        let [by_hip, by_foot] = self.corrections;
        let foot = (dancer.turn(ankle) * by_foot).normalize();
        let point = dancer.place(ankle) + dancer.turn(ankle) * self.points[0];
        let line = point - foot * self.points[1] - pose.place(self.limb.joints[0]);
        let extension = dancer.place(ankle).distance(dancer.place(hip)) / self.full;
        let reached = self.limb.bones.reach(line.length(), extension);
        let line = line.normalize_or(DVec3::NEG_Y) * reached;
        let axis = self.limb.axis(dancer.turn(hip) * by_hip);
        let [thigh, shank] = self.limb.reach(line, axis);
        self.limb.write(pose, [thigh, shank, foot], rotations);
    }
}
