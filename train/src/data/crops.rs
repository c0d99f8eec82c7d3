//! The crops of an epoch, and the music rows beside them.

use std::ops::Range;

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;

use super::{FRAMES_PER_CODE, PHASES};

/// How motions are cut (ARCHITECTURE section 6: 240 frames; stride 40 for the VQ-VAE, 8 for root
/// branch and GPT).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CropPlan {
    /// Frames of a crop.
    pub frames: usize,
    /// Frames between the starts of neighbouring crops.
    pub stride: usize,
    /// Whether half of the crops are mirrored.
    pub mirror: bool,
}

/// Choices of a crop of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Frames; for training with music, those that have music ([`common_frames`]).
    pub frames: usize,
    /// Frames at the start that are in no crop.
    pub skipped: usize,
    /// Songs; none for motion alone.
    pub songs: usize,
    /// Start phases to draw from: 1 keeps the motion as it is, [`PHASES`] moves code boundaries to
    /// every frame.
    pub phases: usize,
}

/// One crop of a motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Draw {
    /// The motion.
    pub dance: usize,
    /// The song out of the motion's songs.
    pub song: usize,
    /// Frames cut off the motion (and as much time off the song) before anything else.
    pub phase: usize,
    /// First frame of the crop in the motion after that cut.
    pub start: usize,
    /// Whether the crop is mirrored.
    pub mirrored: bool,
}

/// Returns the starts of the crops of a motion of `frames` frames; none when it is shorter than one
/// crop.
pub fn crop_starts(frames: usize, length: usize, stride: usize) -> impl Iterator<Item = usize> {
    let starts = (frames + 1).saturating_sub(length);
    (0..starts).step_by(stride.max(1))
}

/// Returns the music rows beside the pose codes `codes` of a motion: row `k + 1` goes with code `k`
/// (ARCHITECTURE section 3: the reference drops the first row).
#[must_use]
pub fn rows_beside(codes: Range<usize>) -> Range<usize> {
    codes.start + 1..codes.end + 1
}

/// Returns the frames of a motion that have music: all codes in them have their row.
///
/// `rows` is the number of conditioning rows of the whole song. It holds for every start phase,
/// since motion and song lose the same time. With several songs take the smallest.
#[must_use]
pub fn common_frames(frames: usize, rows: usize) -> usize {
    frames.min(rows.saturating_sub(1) * FRAMES_PER_CODE)
}

impl CropPlan {
    /// Counts the crops of one round over all motions.
    #[must_use]
    pub fn crops(&self, motions: &[Choice]) -> usize {
        motions.iter().map(|dance| self.starts(dance).count()).sum()
    }

    fn starts(&self, dance: &Choice) -> impl Iterator<Item = usize> + use<> {
        let skipped = dance.skipped;
        crop_starts(dance.frames, self.frames, self.stride).filter(move |&start| start >= skipped)
    }

    /// Draws the crops of a round in random order, the same for the same seed and round: each
    /// motion gives each of its crops once, with a random song, start phase and side. A crop that a
    /// phase pushes over the motion's end moves back by a code.
    #[must_use]
    pub fn round(&self, motions: &[Choice], seed: u64, round: u64) -> Vec<Draw> {
        let random = &mut generator(seed, round);
        let crops = self.places(motions);
        let draws = crops.map(|(dance, start)| self.draw(motions, (dance, start), random));
        let mut draws: Vec<Draw> = draws.collect();
        draws.shuffle(random);
        draws
    }

    /// Draws a round of as many crops, each as often as its share of the weights says: by
    /// systematic sampling, so that no crop is further than one from its share. `weights` has one
    /// for each of [`CropPlan::places`], and not only zeros.
    #[must_use]
    pub fn weighted_round(
        &self,
        motions: &[Choice],
        weights: &[f64],
        seed: u64,
        round: u64,
    ) -> Vec<Draw> {
        let random = &mut generator(seed, round);
        let each = weights.len() as f64 / weights.iter().sum::<f64>();
        let (mut passed, mut drawn) = (random.random::<f64>(), 0.0);
        let mut draws = Vec::with_capacity(weights.len());
        for (place, weight) in self.places(motions).zip(weights) {
            passed += weight * each;
            while drawn + 1.0 <= passed {
                drawn += 1.0;
                draws.push(self.draw(motions, place, random));
            }
        }
        // The sum may be a rounding error short of a whole number.
        if let Some(last) = self.places(motions).last().filter(|_| draws.len() < weights.len()) {
            draws.push(self.draw(motions, last, random));
        }
        draws.truncate(weights.len());
        draws.shuffle(random);
        draws
    }

    /// Returns every crop of a round, a motion and a first frame each.
    pub fn places(&self, motions: &[Choice]) -> impl Iterator<Item = (usize, usize)> {
        let motions = motions.iter().enumerate();
        motions.flat_map(|(dance, choice)| self.starts(choice).map(move |start| (dance, start)))
    }

    /// Draws song, start phase and side of a crop.
    fn draw(
        &self,
        motions: &[Choice],
        (dance, start): (usize, usize),
        random: &mut ChaCha8Rng,
    ) -> Draw {
        let choice = motions[dance];
        let room = choice.frames - self.frames;
        let phases = choice.phases.min(room + 1).clamp(1, PHASES);
        let phase = random.random_range(0..phases);
        let over = start + phase > room;
        Draw {
            dance,
            song: random.random_range(0..choice.songs.max(1)),
            phase,
            start: start.saturating_sub(if over { FRAMES_PER_CODE } else { 0 }),
            mirrored: self.mirror && random.random::<bool>(),
        }
    }
}

fn generator(seed: u64, round: u64) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    generator.set_stream(round);
    generator
}

impl Draw {
    /// Returns the crop's frames in the stored motion.
    #[must_use]
    pub fn frames(&self, length: usize) -> Range<usize> {
        let start = self.phase + self.start;
        start..start + length
    }

    /// Returns the crop's pose codes, counted from the start of the motion after the cut. Only
    /// crops that start on a code boundary have whole codes: the stride must be a multiple of 8.
    #[must_use]
    pub fn codes(&self, length: usize) -> Range<usize> {
        let first = self.start / FRAMES_PER_CODE;
        first..first + length / FRAMES_PER_CODE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crops_cover_what_fits() {
        let starts = |frames| crop_starts(frames, 240, 40).collect::<Vec<_>>();
        assert_eq!(starts(239), [0_usize; 0]);
        assert_eq!(starts(240), [0]);
        assert_eq!(starts(280), [0, 40]);
        assert_eq!(starts(319), [0, 40]);
    }

    #[test]
    fn a_round_weighs_by_dance_and_repeats_by_seed() {
        let plan = CropPlan { frames: 240, stride: 8, mirror: true };
        let dance = |songs, phases| Choice { frames: 600, skipped: 0, songs, phases };
        // The last is as long as a crop: there is nothing to cut off.
        let short = Choice { frames: 240, ..dance(1, PHASES) };
        let skipping = |skipped| Choice { skipped, ..dance(1, 1) };
        let starts = |skipped| {
            let draws = plan.round(&[skipping(skipped)], 7, 0);
            assert_eq!(draws.len(), plan.crops(&[skipping(skipped)]));
            draws.into_iter().map(|draw| draw.start).min()
        };
        assert_eq!([0, 16, 17, 361].map(starts), [Some(0), Some(16), Some(24), None]);
        let motions = [dance(2, PHASES), dance(1, PHASES), dance(0, 1), short];
        let draws = plan.round(&motions, 7, 0);
        assert_eq!(draws.len(), plan.crops(&motions));
        let of = |dance| draws.iter().filter(move |draw| draw.dance == dance);
        assert_eq!([0, 1, 2, 3].map(|dance| of(dance).count()), [46, 46, 46, 1]);
        assert!(of(0).any(|draw| draw.song == 0) && of(0).any(|draw| draw.song == 1));
        assert!(of(1).chain(of(2)).all(|draw| draw.song == 0));
        assert!(of(2).chain(of(3)).all(|draw| draw.phase == 0));
        assert!((0..PHASES).all(|phase| of(0).any(|draw| draw.phase == phase)));
        assert!(draws.iter().any(|draw| draw.mirrored) && !draws.iter().all(|draw| draw.mirrored));
        for draw in &draws {
            assert!(draw.start % FRAMES_PER_CODE == 0 && draw.frames(240).end <= 600);
        }
        assert_eq!(draws, plan.round(&motions, 7, 0));
        assert_ne!(draws, plan.round(&motions, 7, 1));
        assert_ne!(draws, plan.round(&motions, 8, 0));
        let plain = CropPlan { mirror: false, ..plan };
        assert!(plain.round(&motions, 7, 0).iter().all(|draw| !draw.mirrored));
    }

    #[test]
    fn a_weighted_round_draws_crops_by_their_weights() {
        let plan = CropPlan { frames: 240, stride: 8, mirror: true };
        let motion = |frames| Choice { frames, skipped: 0, songs: 1, phases: 1 };
        let motions = [motion(320), motion(240)];
        let places: Vec<_> = plan.places(&motions).collect();
        assert_eq!(places.len(), 12);
        let mut weights = vec![1.0; 12];
        weights[11] = 11.0;
        let mut counts = [0; 12];
        for round in 0..40 {
            let draws = plan.weighted_round(&motions, &weights, 7, round);
            assert_eq!(draws.len(), 12);
            for draw in draws {
                let place = places.iter().position(|&place| place == (draw.dance, draw.start));
                counts[place.unwrap()] += 1;
            }
        }
        // Half of all draws are of the one window of the short motion.
        assert!((235..=245).contains(&counts[11]), "{counts:?}");
        assert!(counts[..11].iter().all(|count| (12..=32).contains(count)), "{counts:?}");
        weights[3] = 0.0;
        let draws = (0..40).flat_map(|round| plan.weighted_round(&motions, &weights, 8, round));
        assert!(draws.into_iter().all(|draw| (draw.dance, draw.start) != places[3]));
    }

    #[test]
    fn every_code_of_the_common_frames_has_its_row_at_any_phase() {
        for samples in [38_400_usize, 38_399, 37_889, 511, 0] {
            let rows = |phase: usize| 1 + samples.saturating_sub(64 * phase) / 512;
            let frames = common_frames(600, rows(0));
            assert!(frames <= 600 && 64 * frames <= samples);
            for phase in 0..PHASES {
                let codes = frames.saturating_sub(phase) / FRAMES_PER_CODE;
                assert!(
                    codes == 0 || rows_beside(0..codes).end <= rows(phase),
                    "{samples} {phase}"
                );
            }
        }
        assert_eq!(common_frames(600, 76), 600);
        assert_eq!(common_frames(600, 0), 0);
    }

    #[test]
    fn rows_are_one_ahead_of_their_codes() {
        assert_eq!(rows_beside(0..29), 1..30);
        let draw = Draw { phase: 3, start: 80, ..Draw::default() };
        assert_eq!(draw.codes(240), 10..40);
        assert_eq!(draw.frames(240), 83..323);
    }
}
