//! The parts of a motion that become samples of `FID` and diversity.

use glam::DVec3;

use crate::{
    body::{Motion, Pose, joint::ROOT},
    error::EvaluationError,
};

/// Frames of a piece in the published protocol: 20 s.
const PUBLISHED_FRAMES: usize = 1_200;

/// The parts of a motion that become samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clips {
    /// The first frames of each piece, or all of a shorter one: the published protocol.
    First(usize),
    /// Every full window, without the tail: more samples than columns, so that covariances of small
    /// sets are not singular.
    Windows {
        /// Frames of a window.
        length: usize,
        /// Frames from the start of one to that of the next.
        stride: usize,
    },
}

impl Default for Clips {
    fn default() -> Self {
        Self::First(PUBLISHED_FRAMES)
    }
}

impl Clips {
    /// Checks that clips are long enough to have a velocity.
    pub(crate) fn check(self) -> Result<(), EvaluationError> {
        match self {
            Self::First(frames) | Self::Windows { length: frames, .. } if frames < 3 => {
                Err(EvaluationError::Option(format!(
                    "a window of {frames} frames is too short: 3 at least"
                )))
            }
            Self::Windows { stride: 0, .. } => {
                Err(EvaluationError::Option("windows need a stride of at least 1 frame".into()))
            }
            _ => Ok(()),
        }
    }

    /// The samples' noun in messages.
    pub(crate) fn noun(self) -> &'static str {
        match self {
            Self::First(_) => "motions",
            Self::Windows { .. } => "windows",
        }
    }

    /// Cuts the clips of a motion, each moved so that its first root is the origin.
    pub(crate) fn of(self, motion: &Motion) -> impl Iterator<Item = Vec<Pose>> {
        let poses = motion.poses();
        let (length, stride) = match self {
            Self::First(frames) => (frames.min(poses.len()), poses.len()),
            Self::Windows { length, stride } => (length, stride),
        };
        poses.windows(length.max(1)).step_by(stride.max(1)).map(to_first_root)
    }
}

fn to_first_root(clip: &[Pose]) -> Vec<Pose> {
    let origin = clip.first().map_or(DVec3::ZERO, |pose| pose[ROOT]);
    clip.iter().map(|pose| pose.map(|place| place - origin)).collect()
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    fn motion(frames: usize) -> Motion {
        let positions = Array3::from_shape_fn((frames, 24, 3), |(frame, _, _)| frame as f32);
        Motion::new("counting", positions.view()).unwrap()
    }

    fn lengths(clips: Clips, frames: usize) -> Vec<usize> {
        clips.of(&motion(frames)).map(|clip| clip.len()).collect()
    }

    const fn windows(length: usize, stride: usize) -> Clips {
        Clips::Windows { length, stride }
    }

    #[test]
    fn motions_are_cut_without_tails() {
        for (clips, frames, expected) in [
            (Clips::default(), 3_000, vec![1_200]),
            (Clips::default(), 700, vec![700]),
            (windows(300, 150), 1_706, vec![300; 10]),
            (windows(300, 150), 600, vec![300; 3]),
            (windows(300, 150), 299, vec![]),
        ] {
            assert_eq!(lengths(clips, frames), expected, "{clips:?} {frames}");
        }
    }

    #[test]
    fn every_clip_begins_at_its_own_root() {
        for clip in windows(10, 10).of(&motion(40)) {
            assert_eq!(clip[0][ROOT], DVec3::ZERO);
            assert_eq!(clip[9][3], DVec3::splat(9.0));
        }
    }

    #[test]
    fn senseless_windows_are_refused() {
        for clips in [Clips::First(2), windows(0, 5), windows(300, 0)] {
            assert!(clips.check().is_err(), "{clips:?}");
        }
    }
}
