//! Which parts of a motion become samples of `FID` and diversity.

use glam::DVec3;

use super::{
    EvaluationError,
    body::{Motion, Pose, joint::ROOT},
};

/// Frames of a piece that the published protocol looks at: 20 s.
pub const PUBLISHED_FRAMES: usize = 1_200;

/// Which parts of a motion become samples.
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
    ///
    /// # Errors
    /// [`EvaluationError::Option`] names what does not fit.
    pub fn check(self) -> Result<(), EvaluationError> {
        match self {
            Self::First(frames) | Self::Windows { length: frames, .. } if frames < 3 => {
                Err(EvaluationError::Option(format!(
                    "a window of {frames} frames is too short: 3 at least"
                )))
            }
            Self::Windows { stride: 0, .. } => Err(EvaluationError::Option(
                "windows need a stride of at least 1 frame".into(),
            )),
            _ => Ok(()),
        }
    }

    /// What the samples are called.
    #[must_use]
    pub fn noun(self) -> &'static str {
        match self {
            Self::First(_) => "motions",
            Self::Windows { .. } => "windows",
        }
    }

    /// The clips of a motion, each moved so that its first root is the origin.
    pub(super) fn of(self, motion: &Motion) -> impl Iterator<Item = Vec<Pose>> {
        let poses = motion.poses();
        let (length, stride) = match self {
            Self::First(frames) => (frames.min(poses.len()), poses.len()),
            Self::Windows { length, stride } => (length, stride),
        };
        poses
            .windows(length.max(1))
            .step_by(stride.max(1))
            .map(to_first_root)
    }
}

fn to_first_root(clip: &[Pose]) -> Vec<Pose> {
    let origin = clip.first().map_or(DVec3::ZERO, |pose| pose[ROOT]);
    clip.iter()
        .map(|pose| pose.map(|place| place - origin))
        .collect()
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

    #[test]
    fn the_published_protocol_takes_the_beginning() {
        assert_eq!(lengths(Clips::default(), 3_000), [1_200]);
        assert_eq!(lengths(Clips::default(), 700), [700]);
    }

    #[test]
    fn windows_have_no_tail() {
        let windows = Clips::Windows {
            length: 300,
            stride: 150,
        };
        assert_eq!(lengths(windows, 1_706).len(), 10);
        assert_eq!(lengths(windows, 600), [300; 3]);
        assert_eq!(lengths(windows, 299), [0; 0]);
    }

    #[test]
    fn every_clip_begins_at_its_own_root() {
        let windows = Clips::Windows {
            length: 10,
            stride: 10,
        };
        for clip in windows.of(&motion(40)) {
            assert_eq!(clip[0][ROOT], DVec3::ZERO);
            assert_eq!(clip[9][3], DVec3::splat(9.0));
        }
    }

    #[test]
    fn senseless_windows_are_refused() {
        for clips in [
            Clips::First(2),
            Clips::Windows {
                length: 0,
                stride: 5,
            },
            Clips::Windows {
                length: 300,
                stride: 0,
            },
        ] {
            assert!(clips.check().is_err(), "{clips:?}");
        }
    }
}
