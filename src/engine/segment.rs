//! Best of n candidates, segment by segment: the candidate whose beats lie nearest to the music's
//! (the reward of Eq. 15 as a choice instead of a lesson), less its share of frames that stand
//! still; none that freezes or goes to the ground, if there is another. A sequence without other
//! candidates is generated again where it freezes.

use std::{cmp::Ordering, ops::RangeInclusive};

use super::window::Window;

/// Codes that are chosen at once: two seconds, a bar or so.
const SEGMENT: usize = 15;
/// A segment ends where the window moves, if it does so after so many codes: the keys and values
/// that candidates share are computed again there anyway, once for all of them.
const SEGMENTS: RangeInclusive<usize> = 12..=29;

/// A candidate with this share of slow frames freezes.
const FREEZING: f64 = 0.1;
/// A sequence without other candidates is scored where at least this share of its lower codes
/// repeat the one before them: so do five of six segments that froze, all that froze for a fifth of
/// their frames, and one of sixteen of all (docs/experiments.md, run 9).
const REPEATED: f64 = 0.25;
/// While the best candidate freezes or goes to the ground, more are tried, up to so many, or so
/// many times: what one request may cost stays bounded.
const MOST_CANDIDATES: usize = 12;
const MOST_ROUNDS: usize = 4;

/// Number of codes at the end of the segment that follows `committed` codes of `total`.
pub(super) fn segment_end(committed: usize, total: usize, window: Window) -> usize {
    let moves = |length: usize| window.moves_at(committed + length - 1);
    // And stays for a while: the first time, it moves twice.
    let moves_last = |&length: &usize| moves(length) && !moves(length + 1);
    let length = SEGMENTS.clone().find(moves_last).unwrap_or(SEGMENT);
    (committed + length).min(total)
}

/// Whether the codes from `committed` on may stand still, which a look at their frames can tell.
pub(super) fn may_freeze(codes: &[[u32; 2]], committed: usize) -> bool {
    let segment = &codes[committed.saturating_sub(1)..];
    let repeated = segment.windows(2).filter(|pair| pair[0][1] == pair[1][1]);
    repeated.count() as f64 >= REPEATED * segment.len().saturating_sub(1) as f64
}

/// How good a candidate is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Score {
    /// How well its beats meet the music's, 0 to 1.
    pub(super) meeting: f64,
    /// Share of its frames that stand still.
    pub(super) slow: f64,
    /// Whether it goes to the ground.
    pub(super) low: bool,
}

impl Score {
    fn is_better_than(self, other: Self) -> bool {
        let worth = |score: Self| score.meeting - score.slow;
        match self.is_good().cmp(&other.is_good()) {
            Ordering::Equal => worth(self) > worth(other),
            better => better.is_gt(),
        }
    }

    fn is_good(self) -> bool {
        self.slow < FREEZING && !self.low
    }
}

/// The candidates of a segment, tried some at a time.
#[derive(Debug, Default)]
pub(super) struct Segment {
    tried: usize,
    best: Option<(Score, Vec<[u32; 2]>)>,
}

impl Segment {
    /// Compares one more candidate with the best so far.
    pub(super) fn consider(&mut self, score: Score, codes: Vec<[u32; 2]>) {
        self.tried += 1;
        let better = |(best, _): &(Score, _)| score.is_better_than(*best);
        if self.best.as_ref().is_none_or(better) {
            self.best = Some((score, codes));
        }
    }

    /// How many were tried.
    pub(super) fn tried(&self) -> usize {
        self.tried
    }

    /// Whether `more` further ones are to be tried.
    pub(super) fn needs(&self, more: usize) -> bool {
        let bad = |(score, _): &(Score, _)| !score.is_good();
        let most = MOST_CANDIDATES.min(MOST_ROUNDS * more);
        self.best.as_ref().is_some_and(bad) && self.tried + more <= most
    }

    /// The best candidate; there is one once one was considered.
    pub(super) fn into_best(self) -> Option<Vec<[u32; 2]>> {
        self.best.map(|(_, codes)| codes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::WindowKind;

    #[test]
    fn a_segment_that_repeats_its_lower_codes_may_freeze() {
        let codes = |lower: &[u32]| -> Vec<[u32; 2]> {
            (0..).zip(lower).map(|(upper, &lower)| [upper, lower]).collect()
        };
        // One of the four codes from the second on is the one before it, then none.
        assert!(may_freeze(&codes(&[1, 2, 2, 3, 4]), 1));
        assert!(!may_freeze(&codes(&[1, 2, 3, 4, 5, 6]), 1));
        assert!(!may_freeze(&codes(&[1, 1, 2, 3, 4, 5, 6]), 2));
    }

    #[test]
    fn segments_end_where_the_window_moves() {
        let ends = |window: Window, total: usize| {
            let mut ends = vec![1];
            while ends.last().is_some_and(|&end| end < total) {
                ends.push(segment_end(ends[ends.len() - 1], total, window));
            }
            ends
        };
        let hop = Window::new(WindowKind::Hop, 15, 28);
        assert_eq!(ends(hop, 80), [1, 30, 44, 58, 72, 80]);
        let shorter = Window::new(WindowKind::Hop, 8, 28);
        assert_eq!(ends(shorter, 80), [1, 30, 51, 72, 80]);
        let shortest = Window::new(WindowKind::Hop, 4, 28);
        assert_eq!(ends(shortest, 80), [1, 30, 55, 80]);
        // A window that moves at every step, or hardly ever.
        let sliding = Window::new(WindowKind::Sliding, 15, 28);
        assert_eq!(ends(sliding, 60), [1, 16, 31, 46, 60]);
        let narrow = Window::new(WindowKind::Hop, 1, 28);
        assert_eq!(ends(narrow, 70), [1, 30, 58, 70]);
    }

    #[test]
    fn a_freezing_best_candidate_is_not_the_last() {
        let score = |meeting: f64, slow: f64| Score { meeting, slow, low: false };
        let mut segment = Segment::default();
        segment.consider(score(0.9, 0.5), vec![[1; 2]]);
        segment.consider(score(0.8, 0.3), vec![[2; 2]]);
        assert!(segment.needs(2));
        segment.consider(score(0.6, 0.05), vec![[3; 2]]);
        segment.consider(score(0.5, 0.0), vec![[4; 2]]);
        assert_eq!(segment.tried(), 4);
        assert!(!segment.needs(2));
        let low = Score { low: true, ..score(1.0, 0.0) };
        segment.consider(low, vec![[5; 2]]);
        assert_eq!(segment.into_best(), Some(vec![[3; 2]]));
        // The number of tries is bounded.
        let mut segment = Segment::default();
        for tried in 0..MOST_CANDIDATES {
            assert_eq!(segment.needs(1), (1..MOST_ROUNDS).contains(&tried));
            for more in [3, 5] {
                let expected = (1..=MOST_CANDIDATES - more).contains(&tried);
                assert_eq!(segment.needs(more), expected);
            }
            segment.consider(score(1.0, 1.0), vec![[tried as u32; 2]]);
        }
    }
}
