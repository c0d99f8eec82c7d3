//! The windows of a step: a function of seed and step alone, so that a resumed run draws the same
//! ones as an undisturbed run.

use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use super::{balance::window_weights, config::BalanceConfig, piece::MotionPiece};
use crate::data::{Choice, CropPlan, Draw};

/// The windows that a stage learns from, drawn again every round.
pub(super) struct Windows {
    plan: CropPlan,
    motions: Vec<Choice>,
    count: usize,
    seed: u64,
    drawn: Option<(u64, Vec<Draw>)>,
    /// One for each window; none where each is drawn once a round.
    weights: Option<Vec<f64>>,
}

impl Windows {
    /// Returns the windows of all motions; `None` where no motion is long enough for one.
    pub(super) fn new(plan: CropPlan, motions: Vec<Choice>, seed: u64) -> Option<Self> {
        let count = plan.crops(&motions);
        (count > 0).then_some(Self { count, plan, motions, seed, drawn: None, weights: None })
    }

    /// Draws windows by how much is worth learning in `pieces`, out of which they are.
    pub(super) fn balanced(self, balance: &BalanceConfig, pieces: &[MotionPiece]) -> Self {
        let places: Vec<(usize, usize)> = self.plan.places(&self.motions).collect();
        let weights = window_weights(balance, pieces, &places, self.plan.frames);
        Self { weights, ..self }
    }

    /// Returns the number of windows in a round.
    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// Returns every window, a motion and a first frame each.
    pub(super) fn places(&self) -> impl Iterator<Item = (usize, usize)> {
        self.plan.places(&self.motions)
    }

    /// Returns the windows of a step: round after round over all motions.
    pub(super) fn batch(&mut self, step: u64, size: usize) -> Vec<Draw> {
        let first = step * size as u64;
        (first..first + size as u64).map(|place| self.at(place)).collect()
    }

    fn at(&mut self, place: u64) -> Draw {
        let count = self.count as u64;
        let (round, index) = (place / count, (place % count) as usize);
        let draws = match self.drawn.take() {
            Some((known, draws)) if known == round => draws,
            _ => match &self.weights {
                Some(weights) => self.plan.weighted_round(&self.motions, weights, self.seed, round),
                None => self.plan.round(&self.motions, self.seed, round),
            },
        };
        let draw = draws[index];
        self.drawn = Some((round, draws));
        draw
    }
}

/// Returns the random numbers of a step.
pub(super) fn generator(seed: u64, step: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(step);
    random
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_holds_every_window_once() {
        let motions = [10, 3, 6].map(|frames| Choice { frames, skipped: 0, songs: 1, phases: 1 });
        let plan = CropPlan { frames: 4, stride: 2, mirror: false };
        let windows = || Windows::new(plan, motions.to_vec(), 7).unwrap();
        let drawn = windows().batch(0, 6);
        assert_eq!(drawn[4..], windows().batch(2, 2));
        let mut places: Vec<_> = drawn.iter().map(|draw| (draw.dance, draw.start)).collect();
        places.sort_unstable();
        assert_eq!(places, [(0, 0), (0, 2), (0, 4), (0, 6), (2, 0), (2, 2)]);
    }
}
