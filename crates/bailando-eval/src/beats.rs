//! Agreement of a motion's beats with the music's: METRICS.md "Beat Align Score", ARCHITECTURE.md
//! section 7, paper Eq. 15.

use rand::{Rng, RngExt};

use crate::body::{JOINTS, Pose};
use bailando_motion::beat_align_score;

/// Random shifts whose mean is the chance level.
const SHIFTS: usize = 20;
/// The smallest shift, from either end of the music, frames.
const LEAST_SHIFT: usize = 20;

/// Mean speed of the joints from each frame to the next, metres per frame: one value fewer than
/// frames.
#[must_use]
pub fn speed(poses: &[Pose]) -> Vec<f64> {
    let pairs = poses.iter().zip(poses.iter().skip(1));
    pairs
        .map(|(before, now)| {
            let distances = before.iter().zip(now).map(|(a, b)| a.distance(*b));
            distances.sum::<f64>() / JOINTS as f64
        })
        .collect()
}

/// Nearness of the music's beats and the dance's in one piece.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeatScore {
    /// Eq. 15: mean over music beats of the nearness of the nearest dance beat.
    pub align: f64,
    /// Mean over dance beats of the nearness of the nearest music beat, as in later papers.
    pub align_dance: f64,
    /// `align` with the music beats shifted at random, mean of 20; none for a piece too short to
    /// shift.
    pub chance: Option<f64>,
}

impl BeatScore {
    /// Scores a piece of `frames` frames. Music beats from the end of the speed curve on are not
    /// counted; none when no music beat is left.
    pub fn new(
        frames: usize,
        music_beats: &[usize],
        dance_beats: &[usize],
        random: &mut impl Rng,
    ) -> Option<Self> {
        let end = frames.saturating_sub(1);
        let music = music_beats.iter().copied().filter(|&beat| beat < end);
        let music: Vec<usize> = music.collect();
        if music.is_empty() {
            return None;
        }
        Some(Self {
            align: beat_align_score(&music, dance_beats),
            align_dance: beat_align_score(dance_beats, &music),
            chance: (frames > 2 * LEAST_SHIFT).then(|| chance(frames, &music, dance_beats, random)),
        })
    }
}

fn chance(frames: usize, music: &[usize], dance: &[usize], random: &mut impl Rng) -> f64 {
    let scores = (0..SHIFTS).map(|_| {
        let shift = random.random_range(LEAST_SHIFT..=frames - LEAST_SHIFT);
        let shifted = music.iter().map(|beat| (beat + shift) % (frames - 1));
        beat_align_score(&shifted.collect::<Vec<_>>(), dance)
    });
    scores.sum::<f64>() / SHIFTS as f64
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::testing::within;

    fn close(got: f64, expected: f64) {
        within(1e-12, got, expected);
    }

    fn random(seed: u64) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(seed)
    }

    #[test]
    fn speed_is_the_mean_of_the_joints() {
        let mut poses = vec![[DVec3::ZERO; JOINTS]; 3];
        poses[1][4] = DVec3::new(3.0, 0.0, 4.0);
        poses[2][4] = DVec3::new(3.0, 0.0, 4.0);
        assert_eq!(speed(&poses), [5.0 / 24.0, 0.0]);
    }

    #[test]
    fn scores_are_means_over_music_and_over_dance_beats() {
        let near = |d: f64| (-d * d / 18.0).exp();
        let score = BeatScore::new(200, &[10, 50, 199], &[13, 49, 120], &mut random(1)).unwrap();
        // Frame 199 is at the end of the speed curve of 199 values.
        close(score.align, (near(3.0) + near(1.0)) / 2.0);
        let over_dance = (near(3.0) + near(1.0) + near(70.0)) / 3.0;
        close(score.align_dance, over_dance);
        assert!(score.chance.unwrap() < score.align);
    }

    #[test]
    fn a_piece_without_beats_has_no_score_or_0() {
        let score = |frames, music: &[usize], dance: &[usize]| {
            BeatScore::new(frames, music, dance, &mut random(1))
        };
        assert_eq!(score(100, &[], &[5]), None);
        assert_eq!(score(100, &[99], &[5]), None);
        let frozen = score(100, &[20, 40], &[]).unwrap();
        assert_eq!((frozen.align, frozen.align_dance), (0.0, 0.0));
        let short = score(30, &[5], &[5]).unwrap();
        assert_eq!((short.align, short.chance), (1.0, None));
    }

    #[test]
    fn chance_follows_from_the_density_of_beats() {
        // A beat every 10 frames, of either kind: shifts are uniform over the ten distances.
        let beats: Vec<usize> = (0..3_000).step_by(10).collect();
        let mut draw = random(7);
        let draws = (0..50).map(|_| chance(3_001, &beats, &beats, &mut draw));
        let mean = draws.sum::<f64>() / 50.0;
        let distances = [0, 1, 2, 3, 4, 5, 4, 3, 2, 1].into_iter();
        let expected = distances.map(|d| (-f64::from(d * d) / 18.0).exp()).sum::<f64>() / 10.0;
        assert!((mean - expected).abs() < 0.02, "{mean} {expected}");
        let again = || chance(3_001, &beats, &beats, &mut random(3));
        close(again(), again());
    }
}
