//! Beats by dynamic programming over the onset envelope (FEATURES sections 9 and 11.5).

use crate::{layout::Rate, median::middle_two};

const TIGHTNESS: f64 = 100.0;
/// Half-width of the score's bell is a beat period over this.
const SHARPNESS: f64 = 32.0;
/// Share of the highest local score below which the first beat does not start.
const FIRST_BEAT_SHARE: f64 = 0.01;
const TRIM_KERNEL: [f64; 5] = [0.0, 0.5, 1.0, 0.5, 0.0];

/// Tempo and beats of a song.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Beats {
    /// Beats per minute; 0 when the onset envelope is silent.
    pub tempo_bpm: f64,
    /// Row indices of the beats (column 53), ascending.
    pub frames: Vec<usize>,
}

impl Beats {
    /// Returns the seconds of the beats, if they were tracked at [`Rate::Beats`].
    pub fn seconds(&self) -> impl Iterator<Item = f64> + '_ {
        let rows_per_second = Rate::Beats.rows_per_second();
        let seconds = move |&frame: &usize| frame as f64 / rows_per_second;
        self.frames.iter().map(seconds)
    }
}

/// The version of librosa's tracker that is reproduced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BeatRules {
    /// librosa 0.10.2 and later.
    Current,
    /// librosa 0.8.1 (FEATURES section 11.5).
    Librosa081,
}

/// Tracker of the beats of an envelope whose beat period is known.
pub(crate) struct BeatTracker {
    rules: BeatRules,
    /// Onset score around each row.
    local: Vec<f64>,
    /// Best score of a beat sequence that ends at each row.
    total: Vec<f64>,
    /// The beat before, for a beat at each row.
    previous: Vec<Option<usize>>,
}

impl BeatTracker {
    pub(crate) fn new(rules: BeatRules) -> Self {
        Self { rules, local: Vec::new(), total: Vec::new(), previous: Vec::new() }
    }

    /// Rows of the beats, ascending; `period` is in rows and at least 1.
    pub(crate) fn track(&mut self, onset: &[f32], period: usize) -> Vec<usize> {
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
        let penalties: Vec<f64> =
            (nearest..=farthest).map(|lag| self.penalty(lag as f64, period as f64)).collect();
        let highest = self.local.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let audible = FIRST_BEAT_SHARE * highest;
        let mut started = false;
        self.total.clear();
        self.previous.clear();
        for row in 0..self.local.len() {
            let best = self.best_predecessor(row, nearest, &penalties);
            let local = self.local[row];
            started = started || local >= audible;
            self.total.push(local + best.map_or(0.0, |best| best.score));
            self.previous.push(best.and_then(|best| best.row).filter(|_| started));
        }
    }

    fn penalty(&self, lag: f64, period: f64) -> f64 {
        let ratio = match self.rules {
            BeatRules::Current => lag.ln() - period.ln(),
            BeatRules::Librosa081 => (lag / period).ln(),
        };
        TIGHTNESS * (ratio * ratio)
    }

    fn best_predecessor(
        &self,
        row: usize,
        nearest: usize,
        penalties: &[f64],
    ) -> Option<Predecessor> {
        let candidate = |(offset, penalty): (usize, &f64)| {
            let row = row.checked_sub(nearest + offset);
            let score = row.map_or(0.0, |row| self.total[row]) - penalty;
            Predecessor { score, row }
        };
        // The first of equals wins.
        let better = |best: Predecessor, next: Predecessor| match next.score > best.score {
            true => next,
            false => best,
        };
        let from_nearest = penalties.iter().enumerate();
        match self.rules {
            BeatRules::Current => {
                let inside = from_nearest.take_while(|(offset, _)| nearest + offset <= row);
                inside.map(candidate).reduce(better)
            }
            // From the farthest on, and a row before the first scores 0.
            BeatRules::Librosa081 => from_nearest.rev().map(candidate).reduce(better),
        }
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
        let peaks = (0..rows).filter(is_peak);
        let mut peaks: Vec<f64> = peaks.map(|row| self.total[row]).collect();
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

    /// Drops leading and trailing beats that hardly exceed the mean strength of beats.
    fn trim(&self, beats: &mut Vec<usize>) {
        let smoothed = self.smoothed_strengths(beats);
        let length = match self.rules {
            BeatRules::Current => self.local.len().min(beats.len() + 2),
            BeatRules::Librosa081 => beats.len(),
        };
        let kept = &smoothed[2..2 + length];
        let threshold = 0.5 * root_mean_square(kept);
        // The current tracker compares all rows, the older one the beats.
        let strengths = match self.rules {
            BeatRules::Current => &self.local[..],
            BeatRules::Librosa081 => kept,
        };
        let strong = |strength: &f64| *strength > threshold;
        let first = strengths.iter().position(strong);
        match first.zip(strengths.iter().rposition(strong)) {
            None => beats.clear(),
            Some((first, last)) => match self.rules {
                BeatRules::Current => beats.retain(|beat| (first..=last).contains(beat)),
                // The last strong beat goes with the weak ones.
                BeatRules::Librosa081 => {
                    beats.truncate(last);
                    beats.drain(..first);
                }
            },
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
        (0..rows).map(|row| if row % period == 5 { 1.0 } else { 0.0 }).collect()
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
        let best = |rules, level, row| {
            let mut tracker = BeatTracker::new(rules);
            tracker.total = vec![level; 10];
            let best = tracker.best_predecessor(row, 2, &[0.0; 4]);
            best.map(|best| (best.row, best.score))
        };
        use BeatRules::{Current, Librosa081};
        assert_eq!(best(Current, 1.0, 9), Some((Some(7), 1.0)));
        assert_eq!(best(Librosa081, 1.0, 9), Some((Some(4), 1.0)));
        assert_eq!(best(Current, 1.0, 1), None);
        // Row 3 can only reach rows 1 and 0 and, in the older version, rows before the first.
        assert_eq!(best(Current, -1.0, 3), Some((Some(1), -1.0)));
        assert_eq!(best(Librosa081, -1.0, 3), Some((None, 0.0)));
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
