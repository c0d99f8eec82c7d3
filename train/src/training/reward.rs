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
    let products = poses.iter().map(facing_product);
    let smallest = products.fold(f64::INFINITY, f64::min);
    if smallest < 0.0 { smallest } else { 1.0 }
}

/// The floor-plane normals of upper and lower body, multiplied. Published with both multiplied by
/// the sign of `u . (head - neck)`; one sign for both leaves their product as it is.
fn facing_product(pose: &Pose) -> f64 {
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
mod tests {
    use super::*;

    fn rule(beat: BeatReward, beat_weight: f64, consistency_weight: f64) -> RewardRule {
        RewardRule { beat, beat_weight, consistency_weight, slow_weight: 0.0, speed_weight: 0.0 }
    }

    /// An upright body, turned about y; the lower half turned further.
    fn pose(facing: f64, twist: f64) -> Pose {
        let turned = |x: f64, y: f64, z: f64, angle: f64| {
            let (sin, cos) = angle.sin_cos();
            DVec3::new(cos * x + sin * z, y, cos * z - sin * x)
        };
        std::array::from_fn(|joint| {
            let place = match joint {
                LEFT_KNEE => turned(0.1, -0.4, 0.05, facing + twist),
                RIGHT_KNEE => turned(-0.1, -0.4, 0.02, facing + twist),
                LEFT_COLLAR => turned(0.08, 0.4, 0.01, facing),
                RIGHT_COLLAR => turned(-0.07, 0.41, 0.0, facing),
                12 => turned(0.0, 0.5, 0.0, facing),
                15 => turned(0.0, 0.6, 0.08, facing),
                _ => DVec3::ZERO,
            };
            place + DVec3::new(3.0, 0.9, -2.0)
        })
    }

    /// ARCHITECTURE section 6, word by word.
    fn by_the_word(pose: &Pose) -> f64 {
        let p = |joint: usize| pose[joint] - pose[0];
        let u = p(14).cross(p(13)).normalize();
        let l = p(4).cross(p(5)).normalize();
        let sign = u.dot(p(15) - p(12)).signum();
        let flat = |v: DVec3| DVec3::new(sign * v.x, 0.0, sign * v.z);
        flat(u).dot(flat(l))
    }

    #[test]
    fn facing_is_as_defined() {
        for facing in [0.0, 1.0, 4.0] {
            for twist in [0.0, 0.8, 2.0, 3.1] {
                let pose = pose(facing, twist);
                let found = facing_product(&pose);
                assert!((found - by_the_word(&pose)).abs() < 1e-12);
                // Nearly upright: the cosine of the twist.
                assert!((found - twist.cos()).abs() < 0.1, "{found} {twist}");
            }
        }
        assert_eq!(facing_product(&[DVec3::ONE; 24]), 0.0);
    }

    #[test]
    fn consistency_is_the_worst_frame_if_that_is_bad() {
        let mut poses = [pose(0.3, 0.2); 8];
        assert_eq!(consistency(&poses), 1.0);
        poses[5] = pose(0.3, 2.5);
        poses[6] = pose(0.3, 2.0);
        assert_eq!(consistency(&poses), by_the_word(&poses[5]));
        poses[5] = pose(0.3, 1.2);
        assert_eq!(consistency(&poses), by_the_word(&poses[6]));
    }

    #[test]
    fn beat_rewards_are_as_defined() {
        let cases = [(false, false), (false, true), (true, false), (true, true)];
        let of = |rule: BeatReward, music: bool, dance: bool| {
            let beats = |any: bool, at: usize| if any { vec![3, at, 40] } else { vec![3, 40] };
            rule.of(&beats(music, 16), &beats(dance, 23), 16..24)
        };
        let paper = cases.map(|(music, dance)| of(BeatReward::Paper, music, dance));
        assert_eq!(paper, [1.0, 1.0, -1.0, 1.0]);
        for (music, dance) in cases {
            let product = f64::from(u8::from(music && dance));
            let found = 5.0 * of(BeatReward::Reference, music, dance);
            assert_eq!(found, (product - 0.5) * 10.0);
        }
        let near = |d: f64| (-d * d / 18.0).exp();
        let align = |music: &[usize], dance: &[usize]| BeatReward::Align.of(music, dance, 16..24);
        assert_eq!(align(&[3, 40], &[15, 24]), 0.0);
        assert_eq!(align(&[20], &[20]), 1.0);
        assert_eq!(align(&[20], &[]), -1.0);
        // A music beat beside a dance beat of the next code; two dance beats, one of them far off.
        assert!((align(&[22], &[25]) - (2.0 * near(3.0) - 1.0)).abs() < 1e-12);
        let mean = (near(1.0) + near(1.0) + near(6.0)) / 3.0;
        assert!((align(&[23], &[17, 22]) - (2.0 * mean - 1.0)).abs() < 1e-12);
    }

    #[test]
    fn a_margin_is_what_is_above_chance() {
        let near = |d: f64| (-d * d / 18.0).exp();
        let margin = |dance: &[usize]| BeatReward::Margin.of(&[10, 30, 50], dance, 24..32);
        // Frames 20 to 39 are nearest to the music beat at 30.
        let chance = (20..40).map(|frame| near(f64::from(frame) - 30.0)).sum::<f64>() / 20.0;
        assert!((margin(&[30]) - (1.0 - chance)).abs() < 1e-12);
        assert!((margin(&[10, 30, 50]) - (1.0 - chance)).abs() < 1e-2);
        assert!(margin(&[40]) < -0.15, "{}", margin(&[40]));
        assert_eq!(margin(&[]), 0.0);
        // Beats everywhere are on every beat, and gain nothing.
        let everywhere: Vec<usize> = (0..60).collect();
        assert!(margin(&everywhere).abs() < 1e-12);
        // No music beat among the frames, or no other one to measure the distance to.
        assert_eq!(BeatReward::Margin.of(&[10, 50], &[30], 24..32), 0.0);
        assert_eq!(BeatReward::Margin.of(&[30], &[30], 24..32), 0.0);
    }

    /// Everything moves along x with a speed that is slowest at frames 20, 60, 100, ..
    fn dance(frames: usize) -> Positions {
        let still = pose(0.0, 0.0);
        let mut moved = 0.0;
        let mut places = Positions::zeros((frames, 24, 3));
        for (frame, mut row) in places.outer_iter_mut().enumerate() {
            for (joint, mut cell) in row.outer_iter_mut().enumerate() {
                let place = still[joint] + DVec3::new(moved, 0.0, 0.0);
                for (axis, value) in cell.iter_mut().enumerate() {
                    *value = place[axis] as f32;
                }
            }
            let phase = std::f64::consts::TAU * (frame as f64 - 20.0) / 40.0;
            moved += 0.02 * (1.5 - phase.cos());
        }
        places
    }

    #[test]
    fn rewards_are_those_of_the_whole_piece() {
        let positions = dance(160);
        let beats = |at: &[usize]| {
            let mut beats = vec![false; 150];
            at.iter().for_each(|&frame| beats[frame] = true);
            beats
        };
        let rule = rule(BeatReward::Paper, 5.0, 1.0);
        // Dance beats are in the codes of frames 20 (code 2), 60 (7), 100 (12) and 140 (17).
        let rewards = rule.rewards(&positions, &beats(&[16, 23, 40, 56, 104]));
        assert_eq!(rewards.len(), 20);
        for (code, reward) in rewards.iter().enumerate() {
            let missed = code == 5 || code == 13;
            let beat = if missed { -1.0 } else { 1.0 };
            assert_eq!((reward.beat, reward.consistency), (beat, 1.0), "{code}");
            assert_eq!(reward.total, 5.0 * beat + 1.0);
        }
        let rule = self::rule(BeatReward::Reference, 5.0, 0.0);
        let rewards = rule.rewards(&positions, &beats(&[16, 23, 40, 56, 104]));
        let good = rewards.iter().enumerate().filter(|(_, r)| r.total == 5.0);
        assert_eq!(good.map(|(code, _)| code).collect::<Vec<_>>(), [2, 7]);
        assert!(rewards.iter().all(|reward| reward.total.abs() == 5.0));
        let quick = RewardRule { speed_weight: 0.5, ..rule };
        // Half of the metres that a second's frames move, beside the same beats.
        let quick = quick.rewards(&positions, &beats(&[16, 23, 40, 56, 104]));
        let speed = speed(&poses(&positions));
        for (code, (quick, plain)) in quick.iter().zip(&rewards).enumerate() {
            let steps = &speed[8 * code..(8 * code + 8).min(speed.len())];
            let gained = 0.5 * 60.0 * steps.iter().sum::<f64>() / steps.len() as f64;
            assert!(gained > 0.1 && (quick.total - plain.total - gained).abs() < 1e-12);
        }
        assert!(rule.rewards(&dance(0), &[]).is_empty());
    }

    #[test]
    fn a_dance_that_is_slowest_on_the_beats_goes_with_the_pulse() {
        let rule = rule(BeatReward::Pulse, 1.0, 0.0);
        let positions = dance(200);
        // The speed is slowest at frames 20, 60, 100, ..; its smoothing mirrors the ends.
        let mean_reward = |first: usize| {
            let mut beats = vec![false; 200];
            (first..200).step_by(40).for_each(|frame| beats[frame] = true);
            let rewards = rule.rewards(&positions, &beats);
            // Codes that lie between the first and the last beat.
            let inner = &rewards[first.div_ceil(8)..(first + 120) / 8];
            inner.iter().map(|reward| reward.beat).sum::<f64>() / inner.len() as f64
        };
        let (on, off, between) = (mean_reward(20), mean_reward(40), mean_reward(30));
        assert!(on > 0.9 && off < -0.9 && between.abs() < 0.2, "{on} {off} {between}");
        // Twice as fast goes with it as well as before.
        let twice = positions.mapv(|metres| 2.0 * metres);
        let mut beats = vec![false; 200];
        (20..200).step_by(40).for_each(|frame| beats[frame] = true);
        let (own, faster) = (rule.rewards(&positions, &beats), rule.rewards(&twice, &beats));
        for (own, faster) in own.iter().zip(&faster) {
            assert!((own.beat - faster.beat).abs() < 1e-3);
        }
        // Nothing to go with.
        assert!(rule.rewards(&positions, &[]).iter().all(|reward| reward.beat == 0.0));
    }
}
