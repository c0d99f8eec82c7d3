//! Beats by dynamic programming over the onset envelope (FEATURES sections 9 and 11.5).

use super::median::middle_two;

const TIGHTNESS: f64 = 100.0;
/// Half-width of the score's bell is a beat period over this.
const SHARPNESS: f64 = 32.0;
/// Share of the highest local score below which the first beat does not start.
const FIRST_BEAT_SHARE: f64 = 0.01;
const TRIM_KERNEL: [f64; 5] = [0.0, 0.5, 1.0, 0.5, 0.0];

/// Whose tracker is reproduced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BeatRules {
    /// librosa 0.10.2 and later.
    Current,
    /// librosa 0.8.1 (FEATURES section 11.5).
    Librosa081,
}

/// Finds the beats of an envelope whose beat period is known.
pub(super) struct BeatTracker {
    rules: BeatRules,
    /// Onset score around each row.
    local: Vec<f64>,
    /// Best score of a beat sequence that ends at each row.
    total: Vec<f64>,
    /// The beat before, for a beat at each row.
    previous: Vec<Option<usize>>,
}

impl BeatTracker {
    pub(super) fn new(rules: BeatRules) -> Self {
        Self {
            rules,
            local: Vec::new(),
            total: Vec::new(),
            previous: Vec::new(),
        }
    }

    /// Rows of the beats, ascending; `period` is in rows and at least 1.
    pub(super) fn track(&mut self, onset: &[f32], period: usize) -> Vec<usize> {
        let Some(normalised) = self.normalise(onset) else {
            return Vec::new();
        };
        self.score_locally(&normalised, period);
        self.link(period);
        let mut beats = self.follow_back();
        self.trim(&mut beats);
        beats
    }

    /// The envelope over its standard deviation, in f32; `None` where there is none.
    fn normalise(&self, onset: &[f32]) -> Option<Vec<f32>> {
        if onset.len() < 2 {
            return None;
        }
        let count = onset.len() as f64;
        let mean = onset.iter().copied().map(f64::from).sum::<f64>() / count;
        let squares: f64 = onset.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum();
        let mut deviation = (squares / (count - 1.0)).sqrt() as f32;
        match self.rules {
            BeatRules::Current => deviation += f32::MIN_POSITIVE,
            BeatRules::Librosa081 if deviation == 0.0 => return None,
            BeatRules::Librosa081 => {}
        }
        Some(onset.iter().map(|x| x / deviation).collect())
    }

    fn score_locally(&mut self, normalised: &[f32], period: usize) {
        let bell: Vec<f64> = (0..=period)
            .map(|distance| {
                let width = SHARPNESS * distance as f64 / period as f64;
                (-0.5 * width * width).exp()
            })
            .collect();
        // The current tracker never looks at row 0.
        let first = match self.rules {
            BeatRules::Current => 1,
            BeatRules::Librosa081 => 0,
        };
        let rows = normalised.len();
        self.local.clear();
        self.local.extend((0..rows).map(|row| {
            let low = row.saturating_sub(period).max(first);
            let high = (row + period).min(rows - 1);
            (low..=high)
                .map(|other| bell[row.abs_diff(other)] * f64::from(normalised[other]))
                .sum::<f64>()
        }));
    }

    fn link(&mut self, period: usize) {
        // A beat follows half a period to two periods after the one before.
        let nearest = ((period as f64 / 2.0).round_ties_even() as usize).max(1);
        let farthest = 2 * period;
        let penalties: Vec<f64> = (nearest..=farthest)
            .map(|lag| self.penalty(lag as f64, period as f64))
            .collect();
        let highest = self.local.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let audible = FIRST_BEAT_SHARE * highest;
        let mut started = false;
        self.total.clear();
        self.previous.clear();
        for row in 0..self.local.len() {
            let best = match self.rules {
                BeatRules::Current => self.best_predecessor(row, nearest, &penalties),
                BeatRules::Librosa081 => self.best_predecessor_081(row, nearest, &penalties),
            };
            let local = self.local[row];
            started = started || local >= audible;
            self.total.push(local + best.map_or(0.0, |best| best.score));
            self.previous
                .push(best.and_then(|best| best.row).filter(|_| started));
        }
    }

    fn penalty(&self, lag: f64, period: f64) -> f64 {
        let ratio = match self.rules {
            BeatRules::Current => lag.ln() - period.ln(),
            BeatRules::Librosa081 => (lag / period).ln(),
        };
        TIGHTNESS * (ratio * ratio)
    }

    /// From the nearest on; the nearest of equals wins.
    fn best_predecessor(
        &self,
        row: usize,
        nearest: usize,
        penalties: &[f64],
    ) -> Option<Predecessor> {
        let mut best: Option<Predecessor> = None;
        for (lag, penalty) in (nearest..=row).zip(penalties) {
            let score = self.total[row - lag] - penalty;
            if best.is_none_or(|best| score > best.score) {
                best = Some(Predecessor {
                    score,
                    row: Some(row - lag),
                });
            }
        }
        best
    }

    /// From the farthest on, where rows before the first score 0; the farthest of equals wins.
    fn best_predecessor_081(
        &self,
        row: usize,
        nearest: usize,
        penalties: &[f64],
    ) -> Option<Predecessor> {
        let mut best: Option<Predecessor> = None;
        for (offset, penalty) in penalties.iter().enumerate().rev() {
            let row = row.checked_sub(nearest + offset);
            let score = row.map_or(0.0, |row| self.total[row]) - penalty;
            if best.is_none_or(|best| score > best.score) {
                best = Some(Predecessor { score, row });
            }
        }
        best
    }

    fn follow_back(&self) -> Vec<usize> {
        let mut beats: Vec<usize> =
            std::iter::successors(Some(self.last_beat()), |&beat| self.previous[beat]).collect();
        beats.reverse();
        beats
    }

    /// The last local maximum of the total score that is at least half of their median.
    fn last_beat(&self) -> usize {
        let rows = self.total.len();
        let is_peak = |&row: &usize| {
            row > 0
                && self.total[row] > self.total[row - 1]
                && (row + 1 == rows || self.total[row] >= self.total[row + 1])
        };
        let mut peaks: Vec<f64> = (0..rows)
            .filter(is_peak)
            .map(|row| self.total[row])
            .collect();
        let Some((lower, upper)) = middle_two(&mut peaks, f64::total_cmp) else {
            return rows - 1;
        };
        let median = (lower + upper) / 2.0;
        (0..rows)
            .rev()
            .filter(is_peak)
            .find(|&row| match self.rules {
                BeatRules::Current => self.total[row] >= 0.5 * median,
                BeatRules::Librosa081 => 2.0 * self.total[row] > median,
            })
            .unwrap_or(rows - 1)
    }

    fn trim(&self, beats: &mut Vec<usize>) {
        match self.rules {
            BeatRules::Current => self.trim_weak_ends(beats),
            BeatRules::Librosa081 => self.trim_weak_ends_081(beats),
        }
    }

    /// Drops leading and trailing beats that hardly exceed the mean strength of beats.
    fn trim_weak_ends(&self, beats: &mut Vec<usize>) {
        let smoothed = self.smoothed_strengths(beats);
        let kept = &smoothed[2..smoothed.len().min(2 + self.local.len())];
        let threshold = 0.5 * root_mean_square(kept);
        let strong = |local: &f64| *local > threshold;
        let first = self.local.iter().position(strong);
        let last = self.local.iter().rposition(strong);
        match first.zip(last) {
            Some((first, last)) => beats.retain(|beat| (first..=last).contains(beat)),
            None => beats.clear(),
        }
    }

    /// Drops weak beats at both ends, and the last strong one with them.
    fn trim_weak_ends_081(&self, beats: &mut Vec<usize>) {
        let smoothed = self.smoothed_strengths(beats);
        let kept = &smoothed[2..2 + beats.len()];
        let threshold = 0.5 * root_mean_square(kept);
        let strong = |strength: &f64| *strength > threshold;
        let first = kept.iter().position(strong);
        let last = kept.iter().rposition(strong);
        match first.zip(last) {
            Some((first, last)) => {
                beats.truncate(last);
                beats.drain(..first);
            }
            None => beats.clear(),
        }
    }

    /// Full convolution of the beats' local scores with the trimming kernel.
    fn smoothed_strengths(&self, beats: &[usize]) -> Vec<f64> {
        let mut smoothed = vec![0.0; beats.len() + TRIM_KERNEL.len() - 1];
        for (index, &beat) in beats.iter().enumerate() {
            for (sum, weight) in smoothed[index..].iter_mut().zip(TRIM_KERNEL) {
                *sum += weight * self.local[beat];
            }
        }
        smoothed
    }
}

#[derive(Clone, Copy)]
struct Predecessor {
    score: f64,
    /// `None` when it lies before the first row.
    row: Option<usize>,
}

fn root_mean_square(values: &[f64]) -> f64 {
    let squares: f64 = values.iter().map(|value| value * value).sum();
    (squares / values.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pulses(rows: usize, period: usize) -> Vec<f32> {
        (0..rows)
            .map(|row| if row % period == 5 { 1.0 } else { 0.0 })
            .collect()
    }

    #[test]
    fn regular_pulses_are_the_beats() {
        let onset = pulses(200, 12);
        let expected: Vec<usize> = (0..200).filter(|row| row % 12 == 5).collect();
        let beats = BeatTracker::new(BeatRules::Current).track(&onset, 12);
        assert_eq!(beats, expected);
        // The older tracker always drops the last strong beat.
        let beats = BeatTracker::new(BeatRules::Librosa081).track(&onset, 12);
        assert_eq!(beats, expected[..expected.len() - 1]);
    }

    #[test]
    fn the_local_score_is_the_weighted_sum_without_row_0() {
        let mut onset = pulses(40, 7);
        onset[0] = 3.0;
        let mut tracker = BeatTracker::new(BeatRules::Current);
        tracker.score_locally(&onset, 9);
        for row in 0..40_usize {
            let direct: f64 = (1..40_usize)
                .filter(|other| row.abs_diff(*other) <= 9)
                .map(|other| {
                    let distance = row.abs_diff(other) as f64;
                    (-0.5 * (32.0 * distance / 9.0).powi(2)).exp() * f64::from(onset[other])
                })
                .sum();
            assert!((tracker.local[row] - direct).abs() < 1e-12);
        }
    }

    #[test]
    fn ties_go_to_the_nearest_and_before_0_8_1_to_the_farthest() {
        let mut tracker = BeatTracker::new(BeatRules::Current);
        tracker.total = vec![1.0; 10];
        let flat = [0.0; 4];
        let row = |best: Option<Predecessor>| best.and_then(|best| best.row);
        assert_eq!(row(tracker.best_predecessor(9, 2, &flat)), Some(7));
        assert_eq!(row(tracker.best_predecessor_081(9, 2, &flat)), Some(4));
        assert_eq!(row(tracker.best_predecessor(1, 2, &flat)), None);
        // Row 3 can only reach rows 1 and 0 and, in the older version, what lies before.
        tracker.total = vec![-1.0; 10];
        assert_eq!(row(tracker.best_predecessor(3, 2, &flat)), Some(1));
        let best = tracker.best_predecessor_081(3, 2, &flat).unwrap();
        assert_eq!((best.row, best.score), (None, 0.0));
    }

    #[test]
    fn tiny_envelopes_do_not_panic() {
        for rules in [BeatRules::Current, BeatRules::Librosa081] {
            let mut tracker = BeatTracker::new(rules);
            for onset in [&[][..], &[1.0], &[1.0, 1.0], &[0.0, 0.0, 1.0], &[0.0; 4]] {
                for period in [1, 2, 40] {
                    let beats = tracker.track(onset, period);
                    assert!(beats.iter().all(|&beat| beat < onset.len()));
                }
            }
        }
    }
}
