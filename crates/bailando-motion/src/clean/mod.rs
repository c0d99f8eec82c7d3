//! Clean-up of a motion for animators: what inverse kinematics of a decoder's joints leaves wrong.
//!
//! Every stage works on local rotations and the root, so that every format carries the same motion,
//! and looks ahead a bounded number of frames, so that a stream can be cleaned as well.

mod capsule;
mod contact;
pub(crate) mod feet;
mod foot;
mod head;
mod hinge;
mod jitter;
pub(crate) mod limb;
mod limbs;
pub(crate) mod pose;

use crate::{
    animation::{Animation, FrameQueue},
    seam::SeamBlend,
    skeleton::Skeleton,
};
use feet::FeetPlanter;
use jitter::JitterFilter;
use limbs::LimbCleaner;

/// Cleans one motion that stands on the floor, piece by piece: jitter, the seam with a motion
/// before it, head, hinges and limits of elbows and knees, hands outside of the body, and last the
/// feet, which everything else moves.
#[derive(Clone, Debug)]
pub(crate) struct Cleaner {
    jitter: JitterFilter,
    seam: Option<SeamBlend>,
    limbs: LimbCleaner,
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
            limbs: LimbCleaner::new(skeleton, fps, continues),
            feet: FeetPlanter::new(skeleton, fps, continues),
        }
    }

    /// Takes the next frames; returns those that are settled.
    pub(crate) fn push(&mut self, animation: Animation) -> Animation {
        let mut smooth = self.jitter.push(animation);
        if let Some(seam) = &mut self.seam {
            smooth = seam.push(smooth);
        }
        self.feet.push(self.limbs.push(smooth))
    }

    /// Returns the rest.
    pub(crate) fn end(&mut self) -> Animation {
        let mut smooth = self.jitter.end();
        if let Some(seam) = &mut self.seam {
            smooth = seam.push(smooth);
            smooth.push_frames(seam.end());
        }
        let mut limbs = self.limbs.push(smooth);
        limbs.push_frames(self.limbs.end());
        let mut feet = self.feet.push(limbs);
        feet.push_frames(self.feet.end());
        feet
    }
}
