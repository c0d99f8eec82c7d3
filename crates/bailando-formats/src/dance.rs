//! The result of a generation.

use std::time::Duration;

use super::{FormatError, Tail};
use bailando_motion::{Animation, Positions, PositionsSource, Skeleton};

/// Pose codes of the two half bodies, one pair per 8 frames at 60 fps.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Codes {
    /// Upper half.
    pub upper: Vec<u32>,
    /// Lower half.
    pub lower: Vec<u32>,
}

/// What was heard in the music (column 53 at 30,720 Hz, profile 0.11).
#[derive(Clone, Debug, PartialEq)]
pub struct MusicInfo {
    /// Beats per minute; 0 when none were found.
    pub tempo_bpm: f64,
    /// Beats in seconds from the start of the dance.
    pub beats_s: Vec<f64>,
}

/// Wall time per stage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Timings {
    /// Waiting for a place in the model's queue.
    pub queue: Duration,
    /// Decoding and resampling the audio.
    pub decode: Duration,
    /// Music features.
    pub features: Duration,
    /// Codes and decoded motion.
    pub inference: Duration,
    /// Rotations, floor and frame rate.
    pub motion: Duration,
}

/// A dance: motion on a skeleton, and how it came about.
#[derive(Clone, Debug)]
pub struct Dance {
    /// Name of the model, from its manifest.
    pub model: String,
    /// The seed that was used.
    pub seed: u64,
    /// Rest skeleton.
    pub skeleton: Skeleton,
    /// Rotations and root, standing on the floor y = 0; carries the frame rate.
    pub animation: Animation,
    /// Joint positions `[frames, joints, 3]`, metres, standing on the floor y = 0.
    pub positions: Positions,
    /// Where the positions come from.
    pub positions_source: PositionsSource,
    /// The pose codes.
    pub codes: Codes,
    /// Tempo and beats, when asked for.
    pub music: Option<MusicInfo>,
    /// Wall time per stage.
    pub timings: Timings,
    /// What was trimmed, truncated or assumed, in plain words.
    pub warnings: Vec<String>,
    /// Where another dance can go on.
    pub tail: Option<Tail>,
}

impl Dance {
    /// Checks that what is written fits together and is finite: formats rely on it.
    pub(super) fn check(&self) -> Result<(), FormatError> {
        let fail = |message: String| Err(FormatError::Inconsistent(message));
        if let Err(error) = self.skeleton.validate() {
            return fail(error.to_string());
        }
        let joints = self.skeleton.joints.len();
        let frames = self.animation.root.len();
        if self.animation.fps == 0 {
            return fail("0 frames per second".into());
        }
        if self.animation.rotations.len() != frames || self.positions.dim() != (frames, joints, 3) {
            return fail(format!(
                "{frames} roots, {} frames of rotations, positions {:?} for {joints} joints",
                self.animation.rotations.len(),
                self.positions.shape()
            ));
        }
        let rotations = &self.animation.rotations;
        if let Some(frame) = rotations.iter().position(|pose| pose.len() != joints) {
            return fail(format!("not {joints} rotations in frame {frame}"));
        }
        let finite = self.animation.root.iter().all(|p| p.is_finite())
            && rotations.iter().flatten().all(|q| q.is_finite())
            && self.positions.iter().all(|v| v.is_finite());
        if !finite {
            return fail("a value is not finite".into());
        }
        if !rotations.iter().flatten().all(|q| q.is_normalized()) {
            return fail("a rotation is not of unit length".into());
        }
        Ok(())
    }
}
