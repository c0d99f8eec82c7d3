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
    legs: LimbCleaner,
    feet: FeetPlanter,
    /// Frames with clean arms and frames with clean feet, until they have both.
    waiting: [Animation; 2],
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
            legs: LimbCleaner::of_legs(skeleton, fps, continues),
            feet: FeetPlanter::new(skeleton, fps, continues),
            waiting: [Animation::empty(fps), Animation::empty(fps)],
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
        let mut feet = self.feet.push(self.legs.end());
        feet.push_frames(self.feet.end());
        done.push_frames(self.join([arms, feet]));
        done
    }

    fn push_smooth(&mut self, smooth: Animation) -> Animation {
        let arms = self.poles.push(self.arms.push(smooth.clone()));
        let feet = self.feet.push(self.legs.push(smooth));
        self.join([arms, feet])
    }

    /// Takes the next frames with clean arms and with clean feet; returns those that have both.
    fn join(&mut self, next: [Animation; 2]) -> Animation {
        for (waiting, next) in self.waiting.iter_mut().zip(next) {
            waiting.push_frames(next);
        }
        let [arms, feet] = &mut self.waiting;
        let count = arms.root.len().min(feet.root.len());
        let (arms, mut done) = (arms.take_frames(count), feet.take_frames(count));
        let joints = self.arms.joints();
        for (pose, arms) in done.rotations.iter_mut().zip(&arms.rotations) {
            for &joint in &joints {
                pose[joint] = arms[joint];
            }
        }
        done
    }
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};

    use super::*;

    #[test]
    fn pieces_make_the_whole_at_every_frame_rate() {
        let swing = |fps: u32| {
            let angle = |frame: usize| (3.0 * frame as f32 / fps as f32).sin();
            let pose = |frame| vec![Quat::from_rotation_x(0.3 * angle(frame)); 24];
            let root = (0..300).map(|frame| Vec3::new(angle(frame), 0.9, 0.0)).collect();
            Animation { fps, root, rotations: (0..300).map(pose).collect() }
        };
        for fps in [10, 20, 24, 30, 60, 120] {
            let cleaned = |piece: usize| {
                let mut cleaner = Cleaner::new(&Skeleton::fixture(), fps, None);
                let (mut rest, mut done) = (swing(fps), Animation::empty(fps));
                while !rest.root.is_empty() {
                    let count = piece.min(rest.root.len());
                    done.push_frames(cleaner.push(rest.take_frames(count)));
                }
                done.push_frames(cleaner.end());
                done
            };
            let whole = cleaned(300);
            assert_eq!(whole.root.len(), 300);
            for piece in [1, 37] {
                assert_eq!(cleaned(piece), whole, "{fps} fps in pieces of {piece}");
            }
        }
    }
}
