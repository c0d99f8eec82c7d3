//! Which windows make up a step: a function of seed and step alone, so that a resumed run draws
//! what an undisturbed one would.

use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};

/// A window's piece and its first frame or code.
pub(super) type Window = (usize, usize);

pub(super) struct Windows {
    all: Vec<Window>,
    seed: u64,
    shuffled: Option<(u64, Vec<Window>)>,
}

impl Windows {
    /// Every `stride`-th window of `length` in pieces of the given lengths.
    pub(super) fn new(
        lengths: impl Iterator<Item = usize>,
        length: usize,
        stride: usize,
        seed: u64,
    ) -> Self {
        let mut all = Vec::new();
        for (piece, available) in lengths.enumerate() {
            if let Some(last) = available.checked_sub(length) {
                all.extend((0..=last).step_by(stride).map(|start| (piece, start)));
            }
        }
        Self {
            all,
            seed,
            shuffled: None,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.all.len()
    }

    /// The windows of a step: rounds over all of them, each in an order of its own.
    pub(super) fn batch(&mut self, step: u64, size: usize) -> Vec<Window> {
        let first = step * size as u64;
        (first..first + size as u64)
            .map(|place| self.at(place))
            .collect()
    }

    fn at(&mut self, place: u64) -> Window {
        let count = self.all.len() as u64;
        let (round, index) = (place / count, (place % count) as usize);
        let order = match self.shuffled.take() {
            Some((known, order)) if known == round => order,
            _ => self.shuffle(round),
        };
        let window = order[index];
        self.shuffled = Some((round, order));
        window
    }

    fn shuffle(&self, round: u64) -> Vec<Window> {
        let mut random = generator(self.seed, round);
        let mut order = self.all.clone();
        for place in (1..order.len()).rev() {
            let other = random.next_u64() % (place as u64 + 1);
            order.swap(place, other as usize);
        }
        order
    }
}

/// The random numbers of a step or round.
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
        let windows = || Windows::new([10, 3, 6].into_iter(), 4, 2, 7);
        let mut drawn: Vec<Window> = windows().batch(0, 6);
        assert_eq!(drawn[4..], windows().batch(2, 2));
        drawn.sort_unstable();
        assert_eq!(drawn, [(0, 0), (0, 2), (0, 4), (0, 6), (2, 0), (2, 2)]);
    }
}
