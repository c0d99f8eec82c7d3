//! Clean-up of a motion for animators: what inverse kinematics of a decoder's joints leaves wrong.
//!
//! Every stage works on local rotations and the root, so that every format carries the same motion,
//! and looks ahead a bounded number of frames, so that a stream can be cleaned as well.

mod avoid;
mod capsule;
mod contact;
pub(crate) mod feet;
mod foot;
mod head;
mod hinge;
mod jitter;
pub(crate) mod limb;
mod limbs;
mod pole;
pub(crate) mod pose;

use crate::{
    animation::{Animation, FrameQueue},
    seam::SeamBlend,
    skeleton::Skeleton,
};
use feet::FeetPlanter;
use jitter::JitterFilter;
use limbs::LimbCleaner;
use pole::PoleDetour;

/// Cleans one motion that stands on the floor, piece by piece: jitter, the seam with a motion
/// before it, head, hinges and limits of elbows and knees, arms outside of the body and past the
/// poles of their angles, and last the feet, which everything else moves. Arms and feet do not ask
/// for each other, and look ahead side by side.
#[derive(Clone, Debug)]
pub(crate) struct Cleaner {
    jitter: JitterFilter,
    seam: Option<SeamBlend>,
    arms: LimbCleaner,
    poles: PoleDetour,
    /// Frames with clean arms, until their feet are.
    waiting: Animation,
    legs: LimbCleaner,
    feet: FeetPlanter,
}

impl Cleaner {
    /// Plans for a motion of a valid skeleton at `fps`, which may continue another one. Limbs that
    /// the skeleton lacks are left out.
    pub(crate) fn new(skeleton: &Skeleton, fps: u32, seam: Option<SeamBlend>) -> Self {
        let continues = seam.is_some();
        Self {
            jitter: JitterFilter::new(fps),
            seam,
            arms: LimbCleaner::of_arms(skeleton, fps, continues),
            poles: PoleDetour::new(skeleton, fps, continues),
            waiting: Animation::empty(fps),
            legs: LimbCleaner::of_legs(skeleton, fps, continues),
            feet: FeetPlanter::new(skeleton, fps, continues),
        }
    }

    /// Takes the next frames; returns those that are settled.
    pub(crate) fn push(&mut self, animation: Animation) -> Animation {
        let mut smooth = self.jitter.push(animation);
        if let Some(seam) = &mut self.seam {
            smooth = seam.push(smooth);
        }
        self.push_smooth(smooth)
    }

    /// Returns the rest.
    pub(crate) fn end(&mut self) -> Animation {
        let mut smooth = self.jitter.end();
        if let Some(seam) = &mut self.seam {
            smooth = seam.push(smooth);
            smooth.push_frames(seam.end());
        }
        let mut done = self.push_smooth(smooth);
        let mut arms = self.poles.push(self.arms.end());
        arms.push_frames(self.poles.end());
        self.waiting.push_frames(arms);
        let mut feet = self.feet.push(self.legs.end());
        feet.push_frames(self.feet.end());
        done.push_frames(self.joined(feet));
        done
    }

    fn push_smooth(&mut self, smooth: Animation) -> Animation {
        let arms = self.poles.push(self.arms.push(smooth.clone()));
        self.waiting.push_frames(arms);
        let feet = self.feet.push(self.legs.push(smooth));
        self.joined(feet)
    }

    /// Gives frames whose feet are clean their clean arms: these look ahead less far.
    fn joined(&mut self, mut feet: Animation) -> Animation {
        let arms = self.waiting.take_frames(feet.root.len());
        let joints = self.arms.joints();
        for (pose, arms) in feet.rotations.iter_mut().zip(&arms.rotations) {
            for &joint in &joints {
                pose[joint] = arms[joint];
            }
        }
        feet
    }
}
