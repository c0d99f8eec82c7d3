//! Best of several candidates, phrase by phrase: of what the model would dance next, that whose beats
//! lie nearest to the music's (the reward of Eq. 15 as a choice instead of a lesson), less its share of
//! frames that stand still; but none that freezes or goes to the ground, if there is another. A single dance is
//! danced anew where it freezes.

use std::ops::RangeInclusive;

use ndarray::{Array2, ArrayView1, ArrayView2, Axis};

use super::{error::of_model, window::Window};
use crate::{
    CancelToken, Result,
    formats::Codes,
    model::{Decoder, Manifest},
    motion::{dance_beats, joint_speed, mutual_beat_alignment, slow_share},
};

/// Codes that are chosen at once: two seconds, a bar or so.
const PHRASE: usize = 15;
/// A phrase ends where the window moves, if it does so after so many: what candidates share is
/// computed anew there anyway, once for all of them.
const PHRASES: RangeInclusive<usize> = 12..=29;
/// Codes at a phrase's end that are judged with the next one: their speed is smoothed, and decoded, with
/// what follows.
const UNSETTLED: usize = 2;
/// Settled codes before those judged that are decoded with them: what is judged is near the dance, not
/// the same, as its decoder sees further; the whole of that would double the cost.
const CONTEXT: usize = 3;

/// A candidate with this share of slow frames freezes.
const FREEZING: f64 = 0.1;
/// A pelvis that is no more metres above the lowest joint is what only a partner holds up: dancers of pairs
/// do so in recordings.
const GROUND: f32 = 0.68;
/// A single dance is looked at where at least this share of its lower codes repeat the one before them: so do five of six
/// phrases that froze, all that froze for a fifth of their frames, and one of sixteen of all (docs/experiments.md, run 9).
const KEPT: f64 = 0.25;
/// While the best candidate freezes or goes to the ground, more are tried until there were so many, or they were tried so many
/// times: what one request may cost stays bounded.
const PATIENCE: usize = 12;
const ROUNDS: usize = 4;

/// Number of codes at the end of the phrase that follows `settled` codes of `total`.
pub(super) fn phrase_end(settled: usize, total: usize, window: Window) -> usize {
    let moves = |length: usize| window.moves_at(settled + length - 1);
    // And stays for a while: the first time, it moves twice.
    let moves_last = |&length: &usize| moves(length) && !moves(length + 1);
    let length = PHRASES.clone().find(moves_last).unwrap_or(PHRASE);
    (settled + length).min(total)
}

/// Whether the codes from `settled` on may stand still, which looking at their frames can tell.
pub(super) fn may_freeze(codes: &Codes, settled: usize) -> bool {
    let from = settled.saturating_sub(1);
    let phrase = codes.lower.get(from..).unwrap_or_default();
    let kept = phrase.windows(2).filter(|pair| pair.first() == pair.last());
    kept.count() as f64 >= KEPT * phrase.len().saturating_sub(1) as f64
}

/// What is thought of a candidate.
#[derive(Clone, Copy, Debug)]
pub(super) struct Verdict {
    /// How well its beats meet the music's, 0 to 1.
    meeting: f64,
    /// Share of its frames that stand still.
    slow: f64,
    /// Whether it goes to the ground.
    low: bool,
}

impl Verdict {
    fn is_better_than(self, other: Self) -> bool {
        let worth = |verdict: Self| verdict.meeting - verdict.slow;
        match (self.is_good(), other.is_good()) {
            (true, false) => true,
            (false, true) => false,
            _ => worth(self) > worth(other),
        }
    }

    fn is_good(self) -> bool {
        self.slow < FREEZING && !self.low
    }
}

/// The candidates of a phrase, tried some at a time.
#[derive(Debug, Default)]
pub(super) struct Phrase {
    tried: usize,
    best: Option<(Verdict, Codes)>,
}

impl Phrase {
    /// Hears of one more candidate.
    pub(super) fn consider(&mut self, verdict: Verdict, codes: Codes) {
        self.tried += 1;
        let better = |(least, _): &(Verdict, Codes)| verdict.is_better_than(*least);
        if self.best.as_ref().is_none_or(better) {
            self.best = Some((verdict, codes));
        }
    }

    /// How many were tried.
    pub(super) fn tried(&self) -> usize {
        self.tried
    }

    /// Whether `more` further ones are to be tried.
    pub(super) fn goes_on(&self, more: usize) -> bool {
        let bad = |(verdict, _): &(Verdict, Codes)| !verdict.is_good();
        let patience = PATIENCE.min(ROUNDS * more);
        self.best.as_ref().is_some_and(bad) && self.tried + more <= patience
    }

    /// The best of them; there is one once one was considered.
    pub(super) fn into_best(self) -> Option<Codes> {
        self.best.map(|(_, codes)| codes)
    }
}

/// What candidates are judged by.
pub(super) struct Judge<'a> {
    /// Frames of the music's beats, ascending.
    pub(super) beats: &'a [usize],
    pub(super) decoder: &'a mut Decoder,
    pub(super) manifest: &'a Manifest,
    pub(super) cancel: &'a CancelToken,
}

impl Judge<'_> {
    /// Judges candidates of one length by the frames that their codes from `settled` on decide about;
    /// `ends` says that no more follow.
    pub(super) fn judge(
        &mut self,
        candidates: &[&Codes],
        settled: usize,
        ends: bool,
    ) -> Result<Vec<Verdict>> {
        let length = candidates.first().map_or(0, |codes| codes.upper.len());
        let from = settled.saturating_sub(UNSETTLED);
        let to = length - if ends { 0 } else { UNSETTLED };
        let first = from.saturating_sub(CONTEXT);
        let half = |of: fn(&Codes) -> &Vec<u32>| {
            let code = |(candidate, code): (usize, usize)| {
                let codes = candidates.get(candidate).map(|codes| of(codes));
                codes.and_then(|codes| codes.get(first + code).copied())
            };
            Array2::from_shape_fn((candidates.len(), length - first), |place| {
                code(place).unwrap_or_default()
            })
        };
        let (upper, lower) = (half(|codes| &codes.upper), half(|codes| &codes.lower));
        let decoded = self
            .decoder
            .decode_batch(upper.view(), lower.view(), self.cancel)
            .map_err(of_model)?;
        decoded
            .axis_iter(Axis(0))
            .map(|motion| self.verdict(motion, first, from..to))
            .collect()
    }

    /// Of the frames of some codes, given the motion from that of code `first` on.
    fn verdict(
        &self,
        motion: ArrayView2<'_, f32>,
        first: usize,
        codes: std::ops::Range<usize>,
    ) -> Result<Verdict> {
        let per_code = self.manifest.frames_per_code;
        let motion = self.manifest.motion_frame.into_world(motion.to_owned())?;
        let speed = joint_speed(motion.view());
        let beats = dance_beats(&speed).into_iter();
        let dance: Vec<usize> = beats.map(|frame| first * per_code + frame).collect();
        let judged = codes.start * per_code..codes.end * per_code;
        let judged_speed: Vec<f64> = speed
            .into_iter()
            .skip(judged.start - first * per_code)
            .take(judged.len())
            .collect();
        Ok(Verdict {
            slow: slow_share(&judged_speed, f64::from(self.manifest.fps)),
            low: motion
                .rows()
                .into_iter()
                .skip(judged.start - first * per_code)
                .take(judged.len())
                .any(|frame| pelvis_height(frame) < GROUND),
            meeting: mutual_beat_alignment(self.beats, &dance, judged).unwrap_or(0.0),
        })
    }
}

/// Metres of the root above the lowest joint, in a frame of root-relative joints.
fn pelvis_height(frame: ArrayView1<'_, f32>) -> f32 {
    // The root's own columns hold its velocity.
    let heights = frame.iter().skip(4).step_by(3);
    -heights.copied().fold(0.0, f32::min)
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;
    use crate::model::WindowKind;

    #[test]
    fn a_pelvis_is_above_the_lowest_joint() {
        let frame = array![
            9.0, -9.0, 9.0, 0.1, -0.5, 0.2, 0.0, -0.8, -1.0, 0.3, 0.6, -2.0
        ];
        assert_eq!(pelvis_height(frame.view()), 0.8);
    }

    #[test]
    fn a_phrase_that_keeps_its_lower_codes_may_freeze() {
        let codes = |lower: &[u32]| Codes {
            upper: (0..lower.len() as u32).collect(),
            lower: lower.to_vec(),
        };
        // One of the four codes from the second on is the one before it, then none.
        assert!(may_freeze(&codes(&[1, 2, 2, 3, 4]), 1));
        assert!(!may_freeze(&codes(&[1, 2, 3, 4, 5, 6]), 1));
        assert!(!may_freeze(&codes(&[1, 1, 2, 3, 4, 5, 6]), 2));
    }

    #[test]
    fn phrases_end_where_the_window_moves() {
        let ends = |window: Window, total: usize| {
            let mut ends = vec![1];
            while ends.last().is_some_and(|&end| end < total) {
                ends.push(phrase_end(ends[ends.len() - 1], total, window));
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
        let codes = |code: u32| Codes {
            upper: vec![code],
            lower: vec![code],
        };
        let verdict = |meeting: f64, slow: f64| Verdict {
            meeting,
            slow,
            low: false,
        };
        let mut phrase = Phrase::default();
        phrase.consider(verdict(0.9, 0.5), codes(1));
        phrase.consider(verdict(0.8, 0.3), codes(2));
        assert!(phrase.goes_on(2));
        phrase.consider(verdict(0.6, 0.05), codes(3));
        phrase.consider(verdict(0.5, 0.0), codes(4));
        assert_eq!(phrase.tried(), 4);
        assert!(!phrase.goes_on(2));
        let low = Verdict {
            low: true,
            ..verdict(1.0, 0.0)
        };
        phrase.consider(low, codes(5));
        assert_eq!(phrase.into_best(), Some(codes(3)));
        // Patience ends.
        let mut phrase = Phrase::default();
        for tried in 0..PATIENCE {
            assert_eq!(phrase.goes_on(1), (1..ROUNDS).contains(&tried));
            assert_eq!(phrase.goes_on(3), (1..=PATIENCE - 3).contains(&tried));
            assert_eq!(phrase.goes_on(5), (1..=PATIENCE - 5).contains(&tried));
            phrase.consider(verdict(1.0, 1.0), codes(tried as u32));
        }
    }
}
