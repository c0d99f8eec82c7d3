//! Comparison of a beat grid with the tracked beats.

use super::facts::median;

/// Fewer beats say nothing about a grid.
const MIN_BEATS: usize = 8;

/// How detected beats lie on a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    /// 1: always at the same place between two beats of the grid; 0: anywhere.
    pub(super) together: f64,
    /// Mean distance of tracked beats after those of the grid, seconds.
    pub(super) late_s: f64,
    /// Number of tracked beats that were compared.
    pub(super) count: usize,
    /// Seconds between the places of tracked beats, at most one beat of the grid.
    pub(super) period_s: f64,
}

/// Trackers also lock on every third half of the count, or on its third.
const FOLDS: [f64; 3] = [1.0, 2.0, 3.0];

impl Fit {
    /// Whether beats strewn at random would look as orderly in 2 of 100 cases (Rayleigh's test).
    pub(super) fn is_chance(&self) -> bool {
        self.together * self.together * (self.count as f64) < 4.0
    }
}

/// Compares by the phase of each detected beat between its neighbours in the grid (a circular
/// mean), so that beats found at half the count fit as well as all of them.
pub(super) fn fit(grid: &[f64], detected: &[f64]) -> Option<Fit> {
    let period = median(&mut gaps(grid));
    let tracked = median(&mut gaps(detected));
    if period <= 0.0 || tracked <= 0.0 {
        return None;
    }
    // Beats tracked at twice the grid's rate, or at two thirds, fall on and halfway between its
    // beats.
    let whole = |fold: &f64| {
        let ratio = fold * tracked / period;
        ratio > 0.5 && (ratio - ratio.round()).abs() < 0.1
    };
    let fold = FOLDS.into_iter().find(whole).unwrap_or(1.0);
    let (mut sine, mut cosine, mut count) = (0.0, 0.0, 0_usize);
    for &time in detected {
        let next = grid.partition_point(|&beat| beat <= time);
        let (Some(&before), Some(&after)) =
            (next.checked_sub(1).and_then(|i| grid.get(i)), grid.get(next))
        else {
            continue;
        };
        let phase = (time - before) / (after - before).max(1e-9);
        let angle = std::f64::consts::TAU * fold * phase;
        sine += angle.sin();
        cosine += angle.cos();
        count += 1;
    }
    let turns = sine.atan2(cosine) / std::f64::consts::TAU;
    (count >= MIN_BEATS).then(|| Fit {
        together: sine.hypot(cosine) / count as f64,
        late_s: turns * period / fold,
        count,
        period_s: period / fold,
    })
}

fn gaps(times: &[f64]) -> Vec<f64> {
    let pairs = times.iter().zip(times.iter().skip(1));
    pairs.map(|(a, b)| b - a).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn every(period: f64, first: f64) -> Vec<f64> {
        (0..40).map(|i| first + f64::from(i) * period).collect()
    }

    #[test]
    fn beats_at_the_count_at_half_and_at_twice_of_it_fit() {
        let grid = every(0.4, 0.0);
        for (period, first) in [(0.4, 0.0), (0.8, 0.4), (0.2, 0.0), (0.6, 0.4)] {
            let fit = fit(&grid, &every(period, first + 0.03)).unwrap();
            assert!(fit.together > 0.99, "{fit:?}");
            assert!((fit.late_s - 0.03).abs() < 1e-6, "{fit:?}");
        }
    }

    #[test]
    fn another_tempo_does_not_fit() {
        let fit = fit(&every(0.4, 0.0), &every(0.43, 0.0)).unwrap();
        assert!(fit.together < 0.3, "{fit:?}");
        assert_eq!(super::fit(&every(0.4, 0.0), &[0.1, 0.5]), None);
        assert_eq!(super::fit(&[], &every(0.4, 0.0)), None);
    }
}
