//! The result of a generation.

use std::{ops::AddAssign, time::Duration};

use bailando_motion::{Animation, Positions, PositionsSource, Skeleton};
use serde::{Serialize, Serializer};

use crate::{codes::Codes, continuation::Continuation, error::FormatError};

/// Tempo, beats and bars of the music; without beats the lists are empty and the numbers 0.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = Music))]
pub struct MusicInfo {
    /// Beats per minute, of `beats_s`; of a tempo that changes, of the distances near their median.
    pub tempo_bpm: f64,
    /// Whether the tempo of every 16 beats is within 3 % of the whole song's.
    pub tempo_steady: bool,
    /// Beats in seconds from the start of the motion.
    pub beats_s: Vec<f64>,
    /// First beats of bars in seconds: some of `beats_s`.
    pub downbeats_s: Vec<f64>,
    /// Beats of a bar: 3 or 4.
    pub metre: usize,
    /// How sure the beats are, from 0 to 1: music has about 0.5 to 0.9.
    pub confidence: f64,
}

/// Wall time per stage; milliseconds where it is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Timings {
    /// Waiting in the queue, then for the model.
    #[serde(serialize_with = "milliseconds")]
    #[cfg_attr(feature = "openapi", schema(value_type = f64))]
    pub queue: Duration,
    /// Decoding and resampling the audio.
    #[serde(serialize_with = "milliseconds")]
    #[cfg_attr(feature = "openapi", schema(value_type = f64))]
    pub decode: Duration,
    /// Music features.
    #[serde(serialize_with = "milliseconds")]
    #[cfg_attr(feature = "openapi", schema(value_type = f64))]
    pub features: Duration,
    /// Codes and decoded motion.
    #[serde(serialize_with = "milliseconds")]
    #[cfg_attr(feature = "openapi", schema(value_type = f64))]
    pub inference: Duration,
    /// Rotations, floor and frame rate.
    #[serde(serialize_with = "milliseconds")]
    #[cfg_attr(feature = "openapi", schema(value_type = f64))]
    pub motion: Duration,
}

impl AddAssign for Timings {
    fn add_assign(&mut self, other: Self) {
        self.queue += other.queue;
        self.decode += other.decode;
        self.features += other.features;
        self.inference += other.inference;
        self.motion += other.motion;
    }
}

fn milliseconds<S: Serializer>(time: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(time.as_micros() as f64 / 1000.0)
}

/// Motion on a skeleton, and how it came about.
#[derive(Clone, Debug)]
pub struct GeneratedMotion {
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
    /// Style of the dance, or `mixed`; none from a model without styles.
    pub style: Option<String>,
    /// Tempo and beats, when asked for.
    pub music: Option<MusicInfo>,
    /// Wall time per stage.
    pub timings: Timings,
    /// What was trimmed, truncated or assumed, in plain words.
    pub warnings: Vec<String>,
    /// Seconds from the start of the song to the first frame.
    pub song_start_s: f64,
    /// The end, from which another motion can continue.
    pub continuation: Option<Continuation>,
}

/// What the sizes of a motion's files depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotionSize {
    /// Frames of the motion.
    pub frames: usize,
    /// Joints of its skeleton.
    pub joints: usize,
    /// Frames a second.
    pub fps: u32,
}

impl GeneratedMotion {
    /// Returns how large it is.
    #[must_use]
    pub fn size(&self) -> MotionSize {
        MotionSize {
            frames: self.animation.root.len(),
            joints: self.skeleton.joints.len(),
            fps: self.animation.fps,
        }
    }

    /// Checks that the parts fit together and are finite: formats rely on it.
    pub(crate) fn check(&self) -> Result<(), FormatError> {
        let fail = |message: String| Err(FormatError::Inconsistent(message));
        if let Err(error) = self.skeleton.validate() {
            return fail(error.to_string());
        }
        let joints = self.skeleton.joints.len();
        let Animation { fps, root, rotations } = &self.animation;
        if *fps == 0 {
            return fail("0 frames per second".into());
        }
        let frames = root.len();
        if rotations.len() != frames || self.positions.dim() != (frames, joints, 3) {
            return fail(format!(
                "{frames} roots, {} frames of rotations, positions {:?} for {joints} joints",
                rotations.len(),
                self.positions.shape()
            ));
        }
        if let Some(frame) = rotations.iter().position(|pose| pose.len() != joints) {
            return fail(format!("not {joints} rotations in frame {frame}"));
        }
        let finite = root.iter().all(|p| p.is_finite())
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
