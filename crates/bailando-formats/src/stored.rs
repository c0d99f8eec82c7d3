//! A motion as the service itself stores it: all of it, so that any format can be written later.
//!
//! Layout: `BMOT`, the version, the length of a JSON header as a little-endian `u32`, the header,
//! then little-endian `f32`: roots `[frames, 3]`, rotations `[frames, joints, 4]` as x y z w,
//! positions `[frames, joints, 3]`.

use std::time::Duration;

use bailando_motion::{Animation, Positions, PositionsSource, Skeleton};
use glam::{Quat, Vec3};
use serde::{Deserialize, Serialize};

use crate::{
    codes::Codes,
    error::FormatError,
    motion::{GeneratedMotion, MotionSize, MusicInfo, Timings},
};

const MAGIC: &[u8; 5] = b"BMOT\x01";
const FLOAT: usize = size_of::<f32>();

#[derive(Serialize, Deserialize)]
struct Header {
    model: String,
    seed: u64,
    skeleton: Skeleton,
    fps: u32,
    frames: usize,
    decoder_positions: bool,
    codes: [Vec<u32>; 2],
    style: Option<String>,
    music: Option<Music>,
    /// Microseconds of queue, decode, features, inference and motion.
    timings_us: [u64; 5],
    warnings: Vec<String>,
    /// What an earlier release stored has none.
    #[serde(default)]
    song_start_s: f64,
    tail: Option<String>,
}

#[derive(Serialize, Deserialize)]
struct Music {
    tempo_bpm: f64,
    tempo_steady: bool,
    beats_s: Vec<f64>,
    downbeats_s: Vec<f64>,
    metre: usize,
    confidence: f64,
}

/// Returns about the most bytes that a motion of this size takes as [`to_stored`] writes it.
#[must_use]
pub fn stored_bytes(size: MotionSize) -> usize {
    // The skeleton, warnings and a continuation; codes and beats, at few frames a second.
    8192 + 128 * size.joints + (8 + floats_of(size)) * size.frames
}

/// Bytes of each frame's numbers.
fn floats_of(size: MotionSize) -> usize {
    FLOAT * (3 + 7 * size.joints)
}

/// Writes a motion so that [`from_stored`] reads the same.
///
/// # Errors
/// [`FormatError::Inconsistent`] for a motion that no format could be written of.
pub fn to_stored(motion: &GeneratedMotion) -> Result<Vec<u8>, FormatError> {
    motion.check()?;
    let header = serde_json::to_vec(&Header::of(motion))?;
    let size = motion.size();
    let floats = size.frames * floats_of(size);
    let mut bytes = Vec::with_capacity(MAGIC.len() + FLOAT + header.len() + floats);
    bytes.extend(MAGIC);
    let length = u32::try_from(header.len())
        .map_err(|_| FormatError::TooLong { format: "motion", bytes: header.len() as u64 })?;
    bytes.extend(length.to_le_bytes());
    bytes.extend(header);
    let mut push = |value: f32| bytes.extend(value.to_le_bytes());
    motion.animation.root.iter().flat_map(|root| root.to_array()).for_each(&mut push);
    let rotations = motion.animation.rotations.iter().flatten();
    rotations.flat_map(|rotation| rotation.to_array()).for_each(&mut push);
    motion.positions.iter().copied().for_each(&mut push);
    Ok(bytes)
}

/// Reads a motion that [`to_stored`] wrote.
///
/// # Errors
/// [`FormatError::Stored`] for other bytes, or too few of them; [`FormatError::Inconsistent`].
pub fn from_stored(bytes: &[u8]) -> Result<GeneratedMotion, FormatError> {
    let broken = |problem: &str| FormatError::Stored(problem.to_owned());
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| broken("it is not one of this version"))?;
    let (length, rest) = rest.split_first_chunk::<FLOAT>().ok_or_else(|| broken("it is cut"))?;
    let length = u32::from_le_bytes(*length) as usize;
    let (header, rest) = rest.split_at_checked(length).ok_or_else(|| broken("it is cut"))?;
    let header: Header =
        serde_json::from_slice(header).map_err(|error| broken(&error.to_string()))?;
    let (joints, frames) = (header.skeleton.joints.len(), header.frames);
    let floats = joints.checked_mul(7).and_then(|each| (each + 3).checked_mul(frames));
    if floats.and_then(|floats| floats.checked_mul(FLOAT)) != Some(rest.len()) {
        return Err(broken("its length is not that of its frames"));
    }
    let (floats, _) = rest.as_chunks::<FLOAT>();
    let mut floats = floats.iter().map(|bytes| f32::from_le_bytes(*bytes));
    let root: Vec<Vec3> =
        (0..frames).filter_map(|_| Some(Vec3::from_array(take(&mut floats)?))).collect();
    let mut pose = || -> Vec<Quat> {
        (0..joints).filter_map(|_| Some(Quat::from_array(take(&mut floats)?))).collect()
    };
    let rotations = (0..frames).map(|_| pose()).collect();
    let positions = Positions::from_shape_vec((frames, joints, 3), floats.collect());
    let positions = positions.map_err(|error| broken(&error.to_string()))?;
    let motion = header.motion(root, rotations, positions);
    motion.check()?;
    Ok(motion)
}

fn take<const N: usize>(floats: &mut impl Iterator<Item = f32>) -> Option<[f32; N]> {
    let mut values = [0.0; N];
    for value in &mut values {
        *value = floats.next()?;
    }
    Some(values)
}

impl Header {
    fn of(motion: &GeneratedMotion) -> Self {
        let Timings { queue, decode, features, inference, motion: made } = motion.timings;
        let micros = |time: Duration| u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        Self {
            model: motion.model.clone(),
            seed: motion.seed,
            skeleton: motion.skeleton.clone(),
            fps: motion.animation.fps,
            frames: motion.animation.root.len(),
            decoder_positions: motion.positions_source == PositionsSource::Decoder,
            codes: [motion.codes.upper.clone(), motion.codes.lower.clone()],
            style: motion.style.clone(),
            music: motion.music.as_ref().map(|music| Music {
                tempo_bpm: music.tempo_bpm,
                tempo_steady: music.tempo_steady,
                beats_s: music.beats_s.clone(),
                downbeats_s: music.downbeats_s.clone(),
                metre: music.metre,
                confidence: music.confidence,
            }),
            timings_us: [queue, decode, features, inference, made].map(micros),
            warnings: motion.warnings.clone(),
            song_start_s: motion.song_start_s,
            tail: motion.continuation.as_ref().map(crate::Continuation::to_text),
        }
    }

    fn motion(
        self,
        root: Vec<Vec3>,
        rotations: Vec<Vec<Quat>>,
        positions: Positions,
    ) -> GeneratedMotion {
        let [upper, lower] = self.codes;
        let [queue, decode, features, inference, motion] =
            self.timings_us.map(Duration::from_micros);
        GeneratedMotion {
            model: self.model,
            seed: self.seed,
            skeleton: self.skeleton,
            animation: Animation { fps: self.fps, root, rotations },
            positions,
            positions_source: match self.decoder_positions {
                true => PositionsSource::Decoder,
                false => PositionsSource::ForwardKinematics,
            },
            codes: Codes { upper, lower },
            style: self.style,
            music: self.music.map(|music| MusicInfo {
                tempo_bpm: music.tempo_bpm,
                tempo_steady: music.tempo_steady,
                beats_s: music.beats_s,
                downbeats_s: music.downbeats_s,
                metre: music.metre,
                confidence: music.confidence,
            }),
            timings: Timings { queue, decode, features, inference, motion },
            warnings: self.warnings,
            song_start_s: self.song_start_s,
            // One that went too far has no text that can be read.
            continuation: self.tail.and_then(|tail| tail.parse().ok()),
        }
    }
}
