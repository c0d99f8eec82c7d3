//! Rewards of generated motion, code by code (paper Eq. 12-14, ARCHITECTURE section 6).

use std::ops::Range;

use bailando::{
    evaluation::{Pose, speed},
    motion::{
        Positions, beat_align_score, dance_beats, mutual_beat_alignment, slow_share, smoothed,
    },
};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::data::FRAMES_PER_CODE;

/// Frames per second of motion.
const FPS: f64 = 60.0;

/// SMPL joints that the consistency of the halves is read from.
const LEFT_KNEE: usize = 4;
const RIGHT_KNEE: usize = 5;
const LEFT_COLLAR: usize = 13;
const RIGHT_COLLAR: usize = 14;

/// The kinds of beat reward.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BeatReward {
    /// Eq. 13: -1 for a code with a music beat but no dance beat, else 1.
    Paper,
    /// That of the published program: 1 for a code with a music beat and a dance beat, else -1.
    /// Five times this is its `(music beat x dance beat - 0.5) x 10`.
    Reference,
    /// Ours: the mean over the code's beats, of music and motion, of their nearness to the other's
    /// beats (the terms of Eq. 15), from -1 to 1; 0 for a code without beats. Without the motion's
    /// own beats in the mean, more of them would always pay.
    Align,
    /// Ours, Eq. 15 above chance: the mean over the code's music beats of the motion's nearness to
    /// them, less its mean over the frames to which no other music beat is nearer; 0 for a code
    /// without music beats. More beats of the motion at random places gain nothing.
    Margin,
    /// Ours: how well the smoothed speed follows the music's pulse, slowest on the beats and
    /// fastest between them. It is the correlation of the speed with minus the cosine of the place
    /// between two beats; a code gets the part of its frames. From -1 to 1 for a whole piece, 0 for
    /// frames outside the beats. Every frame counts, and slower motion gains nothing.
    Pulse,
}

/// Weights of the rewards: `beat_weight * R_b + consistency_weight * R_c` (Eq. 12).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RewardRule {
    /// Which `R_b`.
    pub beat: BeatReward,
    /// Weight of `R_b`.
    pub beat_weight: f64,
    /// Weight of `R_c`.
    pub consistency_weight: f64,
    /// Penalty of a code whose frames are all slow (METRICS.md), else their share of it: standing
    /// still has no beat to miss.
    pub slow_weight: f64,
    /// Gain of a code for each metre per second of its frames' mean joint speed: where only beats
    /// count, slow motion is safer.
    pub speed_weight: f64,
}

/// The reward of one code.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reward {
    /// The weighted sum.
    pub total: f64,
    /// `R_b`: whether the 8 frames follow the beat.
    pub beat: f64,
    /// `R_c` (Eq. 14): whether both halves have one heading.
    pub consistency: f64,
}

impl RewardRule {
    /// Computes the rewards of the codes of a whole piece: 8 frames of world positions each,
    /// `music_beats` by frame (frames beyond its end have none).
    ///
    /// A dance beat is a minimum of smoothed speed, which reaches over 20 frames either way: it is
    /// found in the whole piece, never in 8 frames alone. Both programs look at the 8 frames, so
    /// beats need not fall on the same frame.
    #[must_use]
    pub fn rewards(&self, positions: &Positions, music_beats: &[bool]) -> Vec<Reward> {
        let poses = poses(positions);
        let speed = speed(&poses);
        let dance = dance_beats(&speed);
        let pulse = pulse(music_beats, &speed);
        let music = music_beats.iter().enumerate();
        let music: Vec<usize> = music.filter_map(|(frame, &beat)| beat.then_some(frame)).collect();
        let codes = poses.chunks(FRAMES_PER_CODE).enumerate();
        let rewards = codes.map(|(code, poses)| {
            let first = code * FRAMES_PER_CODE;
            let frames = first..first + poses.len();
            let beat = match self.beat {
                BeatReward::Pulse => mean(pulse.get(frames).unwrap_or_default()),
                beat => beat.of(&music, &dance, frames),
            };
            let mut reward = self.weighed(beat, consistency(poses));
            let steps = speed.get(first..(first + poses.len()).min(speed.len()));
            let steps = steps.unwrap_or_default();
            reward.total -= self.slow_weight * slow_share(steps, FPS);
            reward.total += self.speed_weight * FPS * mean(steps);
            reward
        });
        rewards.collect()
    }

    fn weighed(&self, beat: f64, consistency: f64) -> Reward {
        Reward {
            total: self.beat_weight * beat + self.consistency_weight * consistency,
            beat,
            consistency,
        }
    }
}

impl BeatReward {
    /// Computes the reward of the code of some frames, given all beats in ascending order.
    fn of(self, music: &[usize], dance: &[usize], frames: Range<usize>) -> f64 {
        let within = |beats: &[usize]| beats.iter().any(|beat| frames.contains(beat));
        let (has_music, has_dance) = (within(music), within(dance));
        let good = match self {
            Self::Paper => has_dance || !has_music,
            Self::Reference => has_dance && has_music,
            Self::Align => {
                let meeting = mutual_beat_alignment(music, dance, frames);
                return meeting.map_or(0.0, |meeting| 2.0 * meeting - 1.0);
            }
            Self::Margin => return margin(music, dance, frames),
            // Computed from the speed, not from the motion's beats.
            Self::Pulse => return 0.0,
        };
        if good { 1.0 } else { -1.0 }
    }
}

/// See [`BeatReward::Margin`]. Two beats of the music are needed to know their distance.
fn margin(music: &[usize], dance: &[usize], frames: Range<usize>) -> f64 {
    let of_beat = |place: usize| {
        let beat = *music.get(place)?;
        let half_way = |other: Option<&usize>| other.map(|&other| other.abs_diff(beat) / 2);
        let before = half_way(place.checked_sub(1).and_then(|before| music.get(before)));
        let after = half_way(music.get(place + 1));
        // At either end of the music the other side's distance stands for both.
        let (before, after) = (before.or(after)?, after.or(before)?);
        let around: Vec<usize> = (beat.saturating_sub(before)..beat + after.max(1)).collect();
        Some(beat_align_score(&[beat], dance) - beat_align_score(&around, dance))
    };
    let first = music.partition_point(|&beat| beat < frames.start);
    let end = music.partition_point(|&beat| beat < frames.end);
    let margins: Vec<f64> = (first..end).filter_map(of_beat).collect();
    mean(&margins)
}

/// Computes each frame's part in the correlation of smoothed speed and the music's pulse.
fn pulse(music_beats: &[bool], speed: &[f64]) -> Vec<f64> {
    let smooth = smoothed(speed);
    let middle = mean(&smooth);
    let deviations: Vec<f64> = smooth.iter().map(|speed| speed - middle).collect();
    let spread = mean(&deviations.iter().map(|d| d * d).collect::<Vec<_>>()).sqrt();
    let mut pulse = vec![0.0; speed.len()];
    if spread <= f64::EPSILON {
        return pulse;
    }
    let beats = music_beats.iter().take(speed.len()).enumerate();
    let beats: Vec<usize> = beats.filter_map(|(frame, &beat)| beat.then_some(frame)).collect();
    for pair in beats.windows(2) {
        let &[from, to] = pair else { continue };
        for frame in from..to {
            let place = (frame - from) as f64 / (to - from) as f64;
            let wanted = -(std::f64::consts::TAU * place).cos();
            // A cosine's own spread is the root of a half.
            pulse[frame] = std::f64::consts::SQRT_2 * wanted * deviations[frame] / spread;
        }
    }
    pulse
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Eq. 14: the smallest product of the halves' headings over the frames if it is negative, else 1.
fn consistency(poses: &[Pose]) -> f64 {
    let products = poses.iter().map(heading_product);
    let smallest = products.fold(f64::INFINITY, f64::min);
    if smallest < 0.0 { smallest } else { 1.0 }
}

/// The floor-plane normals of upper and lower body, multiplied. Published with both multiplied by
/// the sign of `u . (head - neck)`; one sign for both leaves their product as it is.
fn heading_product(pose: &Pose) -> f64 {
    let from_root = |joint: usize| pose[joint] - pose[0];
    // On the floor, and not normalised again: a half that lies flat hardly counts.
    let normal = |a: usize, b: usize| {
        let cross = from_root(a).cross(from_root(b)).normalize_or_zero();
        DVec3::new(cross.x, 0.0, cross.z)
    };
    let upper = normal(RIGHT_COLLAR, LEFT_COLLAR);
    upper.dot(normal(LEFT_KNEE, RIGHT_KNEE))
}

fn poses(positions: &Positions) -> Vec<Pose> {
    let frames = positions.outer_iter();
    let pose = |frame: ndarray::ArrayView2<'_, f32>| -> Pose {
        std::array::from_fn(|joint| {
            let axis = |axis| frame.get((joint, axis)).copied().map_or(f64::NAN, f64::from);
            DVec3::new(axis(0), axis(1), axis(2))
        })
    };
    frames.map(pose).collect()
}

#[cfg(test)]
mod tests;
