//! Clean-up of a motion for animators: what inverse kinematics of a decoder's joints leaves wrong.
//!
//! Every stage works on local rotations and the root, so that every format carries the same motion,
//! and looks ahead a bounded number of frames, so that a stream can be cleaned as well.

mod capsule;
mod contact;
mod feet;
mod foot;
mod head;
mod hinge;
mod jitter;
mod limb;
mod limbs;
mod pose;

use crate::{
    animation::{Animation, FrameQueue},
    skeleton::Skeleton,
};
use feet::FeetPlanter;
use jitter::JitterFilter;
use limbs::LimbCleaner;

/// Cleans one motion that stands on the floor, piece by piece: jitter, head, hinges and limits of
/// elbows and knees, hands outside of the body, and last the feet, which everything else moves.
#[derive(Clone, Debug)]
pub(crate) struct Cleaner {
    jitter: JitterFilter,
    limbs: LimbCleaner,
    feet: FeetPlanter,
}

impl Cleaner {
    /// Plans for a motion of a valid skeleton at `fps`, which may continue another one that was
    /// cleaned. Limbs that the skeleton lacks are left out.
    pub(crate) fn new(skeleton: &Skeleton, fps: u32, continues: bool) -> Self {
        Self {
            jitter: JitterFilter::new(fps),
            limbs: LimbCleaner::new(skeleton, fps, continues),
            feet: FeetPlanter::new(skeleton, fps, continues),
        }
    }

    /// Takes the next frames; returns those that are settled.
    pub(crate) fn push(&mut self, animation: Animation) -> Animation {
        self.feet.push(self.limbs.push(self.jitter.push(animation)))
    }

    /// Returns the rest.
    pub(crate) fn end(&mut self) -> Animation {
        let smooth = self.jitter.end();
        let mut limbs = self.limbs.push(smooth);
        limbs.push_frames(self.limbs.end());
        let mut feet = self.feet.push(limbs);
        feet.push_frames(self.feet.end());
        feet
    }
}
