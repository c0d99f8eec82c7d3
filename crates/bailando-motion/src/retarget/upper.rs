//! The world rotations of hips, spine, head and arms.

use glam::{DQuat, DVec3};

use super::{
    figure::{BodyPart, Figure, Side},
    stance::Stance,
};
use crate::{
    clean::pose::WorldPose, error::MotionError, floor::STANDING_HEIGHT, skeleton::Skeleton,
};

/// Joints of a dancer by the parts of the body.
#[derive(Clone, Debug)]
pub(super) struct Dancer {
    /// Pelvis and the three joints above it.
    trunk: [usize; 4],
    neck: usize,
    head: usize,
    sides: [SideJoints; 2],
}

/// Joints of one side: collar, shoulder, elbow, wrist, hand; hip, knee, ankle, ball.
#[derive(Clone, Copy, Debug)]
pub(super) struct SideJoints {
    arm: [usize; 5],
    pub(super) leg: [usize; 4],
}

impl Dancer {
    pub(super) fn of(skeleton: &Skeleton) -> Result<Self, MotionError> {
        let joint = |name: &str| {
            let found = skeleton.joints.iter().position(|joint| joint == name);
            let missing = || MotionError::Skeleton(format!("it has no joint `{name}`"));
            found.ok_or_else(missing)
        };
        let side = |side: &str| {
            let joint = |name: &str| joint(&format!("{side}_{name}"));
            Ok::<_, MotionError>(SideJoints {
                arm: [
                    joint("collar")?,
                    joint("shoulder")?,
                    joint("elbow")?,
                    joint("wrist")?,
                    joint("hand")?,
                ],
                leg: [joint("hip")?, joint("knee")?, joint("ankle")?, joint("foot")?],
            })
        };
        Ok(Self {
            trunk: [joint("pelvis")?, joint("spine1")?, joint("spine2")?, joint("spine3")?],
            neck: joint("neck")?,
            head: joint("head")?,
            sides: [side("l")?, side("r")?],
        })
    }

    pub(super) fn side(&self, side: Side) -> SideJoints {
        self.sides[side as usize]
    }

    pub(super) fn pelvis(&self) -> usize {
        self.trunk[0]
    }

    /// Returns the mean length of both legs from hip to floor along their bones, metres.
    pub(super) fn leg_length(&self, skeleton: &Skeleton) -> f64 {
        let length = |side: &SideJoints| {
            let [_, knee, ankle, ball] = side.leg.map(|joint| skeleton.offset(joint).as_dvec3());
            knee.length() + ankle.length() - ball.y + f64::from(STANDING_HEIGHT)
        };
        0.5 * self.sides.iter().map(length).sum::<f64>()
    }

    /// Returns the rotation at a share of the trunk, from 0 for the pelvis to 1 for the chest.
    fn trunk_at(&self, pose: &WorldPose, share: f64) -> DQuat {
        let place = 3.0 * share.clamp(0.0, 1.0);
        let below = (place as usize).min(2);
        let [from, to] = [below, below + 1].map(|at| pose.turn(self.trunk[at]));
        from.slerp(to, place - below as f64)
    }
}

/// What the rotation of one bone follows.
#[derive(Clone, Copy, Debug)]
enum Follows {
    /// A share of the trunk.
    Trunk(f64),
    /// A share of the way from the chest's rotation to the neck's.
    Neck(f64),
    /// A joint, after the turn from the figure's rest pose to the dancer's.
    Joint(usize, DQuat),
}

/// How every bone of a figure follows a dancer; those of legs get what the legs' own plan says.
#[derive(Clone, Debug)]
pub(super) struct UpperBody(Vec<Follows>);

impl UpperBody {
    pub(super) fn new(
        skeleton: &Skeleton,
        dancer: &Dancer,
        figure: &Figure,
        stance: &Stance,
    ) -> Self {
        let count =
            |part: BodyPart| figure.bones.iter().filter(|bone| bone.part == part).count() as f64;
        let counts = [BodyPart::Spine, BodyPart::Neck].map(count);
        let arms = Side::BOTH.map(|side| arm_corrections(skeleton, dancer, figure, stance, side));
        let mut passed = [0.0; 2];
        let follows = figure.bones.iter().map(|bone| match bone.part {
            BodyPart::Hips => Follows::Trunk(0.0),
            BodyPart::Spine => {
                passed[0] += 1.0;
                Follows::Trunk(passed[0] / counts[0])
            }
            BodyPart::Neck => {
                passed[1] += 1.0;
                Follows::Neck(passed[1] / counts[1])
            }
            BodyPart::Head => Follows::Joint(dancer.head, DQuat::IDENTITY),
            BodyPart::Shoulder(side) => Follows::Joint(dancer.side(side).arm[0], DQuat::IDENTITY),
            BodyPart::UpperArm(side) => {
                Follows::Joint(dancer.side(side).arm[1], arms[side as usize][0])
            }
            BodyPart::LowerArm(side) => {
                Follows::Joint(dancer.side(side).arm[2], arms[side as usize][1])
            }
            BodyPart::Hand(side) => {
                Follows::Joint(dancer.side(side).arm[3], arms[side as usize][1])
            }
            BodyPart::UpperLeg(_)
            | BodyPart::LowerLeg(_)
            | BodyPart::Foot(_)
            | BodyPart::Toes(_) => Follows::Trunk(0.0),
        });
        Self(follows.collect())
    }

    /// Returns the world rotation of every bone from its rest, in the frame of dances.
    pub(super) fn turns(&self, dancer: &Dancer, pose: &WorldPose) -> Vec<DQuat> {
        let turn = |follows: &Follows| match *follows {
            Follows::Trunk(share) => dancer.trunk_at(pose, share),
            Follows::Neck(share) => dancer.trunk_at(pose, 1.0).slerp(pose.turn(dancer.neck), share),
            Follows::Joint(joint, correction) => pose.turn(joint) * correction,
        };
        self.0.iter().map(turn).collect()
    }
}

/// Returns the turns of upper and lower arm from where the figure's rest to where the dancer's do.
fn arm_corrections(
    skeleton: &Skeleton,
    dancer: &Dancer,
    figure: &Figure,
    stance: &Stance,
    side: Side,
) -> [DQuat; 2] {
    let place = |part| figure.place(part).map(|place| stance.into_dance(place));
    let parts = [BodyPart::UpperArm(side), BodyPart::LowerArm(side), BodyPart::Hand(side)];
    let [upper, lower, hand] = parts.map(place);
    let [_, _, elbow, wrist, _] = dancer.side(side).arm;
    let [own_upper, own_lower] = [elbow, wrist].map(|joint| skeleton.offset(joint).as_dvec3());
    let between = |from: Option<DVec3>, to: Option<DVec3>| from.zip(to).map(|(a, b)| b - a);
    let first = between(upper, lower).map(|bone| correction(bone, own_upper));
    let first = first.unwrap_or(DQuat::IDENTITY);
    let second = between(lower, hand).map_or(first, |bone| correction(bone, own_lower));
    [first, second]
}

/// Returns the smallest turn from one direction to another; none where one has no length.
pub(super) fn correction(from: DVec3, to: DVec3) -> DQuat {
    match (from.try_normalize(), to.try_normalize()) {
        (Some(from), Some(to)) => DQuat::from_rotation_arc(from, to),
        _ => DQuat::IDENTITY,
    }
}
