//! A dance on another figure: world rotations from the rest pose, a path as long as the legs
//! allow, and feet that stand where the figure's own legs reach the floor.

mod figure;
mod legs;
mod stance;
mod upper;

use glam::{DQuat, DVec3};

pub use figure::{BodyPart, Figure, FigureBone, Side};

use crate::{animation::Animation, clean::pose::WorldPose, error::MotionError, skeleton::Skeleton};
use legs::LegRetargeter;
use stance::Stance;
use upper::{Dancer, UpperBody};

/// A dance on a figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Retargeted {
    /// Frames per second.
    pub fps: u32,
    /// Where the bone of the hips is, one a frame, in the figure's unit and axes.
    pub hips: Vec<DVec3>,
    /// World rotation of every bone from its rest, `[frame][bone]`, about the figure's axes.
    pub turns: Vec<Vec<DQuat>>,
}

/// Puts dances of one skeleton on one figure.
#[derive(Clone, Debug)]
pub struct Retargeter {
    pose: WorldPose,
    dancer: Dancer,
    stance: Stance,
    upper: UpperBody,
    legs: LegRetargeter,
    parts: Vec<BodyPart>,
}

impl Retargeter {
    /// Plans for dances of `skeleton`, whose joints have SMPL's names.
    ///
    /// # Errors
    /// [`MotionError::Skeleton`] if the skeleton lacks joints, [`MotionError::Figure`] if the
    /// figure lacks bones or is no standing humanoid.
    pub fn new(skeleton: &Skeleton, figure: &Figure) -> Result<Self, MotionError> {
        skeleton.validate()?;
        let dancer = Dancer::of(skeleton)?;
        let (stance, legs) = Stance::of(figure, dancer.leg_length(skeleton))?;
        let hips = figure.place(BodyPart::Hips).map_or(DVec3::ZERO, |hips| stance.into_dance(hips));
        Ok(Self {
            pose: WorldPose::new(skeleton),
            upper: UpperBody::new(skeleton, &dancer, figure, &stance),
            legs: LegRetargeter::new(skeleton, &dancer, hips, legs)?,
            parts: figure.bones.iter().map(|bone| bone.part).collect(),
            dancer,
            stance,
        })
    }

    /// Puts a dance on the figure. Its feet are held in place again where they stood if they are
    /// to be `planted`.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the dance has other joints than the skeleton.
    pub fn retarget(&self, dance: &Animation, planted: bool) -> Result<Retargeted, MotionError> {
        let frames = dance.root.len();
        if dance.rotations.len() != frames
            || dance.rotations.iter().any(|pose| pose.len() != self.pose.joints())
        {
            return Err(MotionError::Shape {
                expected: format!("{frames} poses of {} joints", self.pose.joints()),
                got: format!("{} poses", dance.rotations.len()),
            });
        }
        let mut pose = self.pose.clone();
        let mut turns = Vec::with_capacity(frames);
        let mut stepping = self.legs.start(dance.fps);
        for (root, rotations) in dance.root.iter().zip(&dance.rotations) {
            pose.set(*root, rotations);
            turns.push(self.upper.turns(&self.dancer, &pose));
            self.legs.follow(&mut stepping, &pose);
        }
        let stepped = self.legs.end(stepping, planted);
        let mut hips = Vec::with_capacity(frames);
        for ((root, legs), turns) in stepped.into_iter().zip(&mut turns) {
            hips.push(self.stance.place(root));
            for (part, turn) in self.parts.iter().zip(turns) {
                *turn = self.stance.turn(legs.of(*part).unwrap_or(*turn));
            }
        }
        Ok(Retargeted { fps: dance.fps, hips, turns })
    }
}
