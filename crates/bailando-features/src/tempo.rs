//! One tempo for the clip (FEATURES section 9).

use super::tempogram::Tempogram;

const WINDOW_SECONDS: f64 = 8.0;
const EXPECTED_BPM: f64 = 120.0;
const FASTEST_BPM: f64 = 320.0;

/// Averages a tempogram over the clip and weighs its lags by how usual their tempo is.
pub(super) struct TempoEstimator {
    rows_per_minute: f64,
    tempogram: Tempogram,
    mean: Vec<f64>,
}

/// The beat period of a clip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tempo {
    /// Rows per beat.
    pub(super) period: usize,
    pub(super) bpm: f64,
}

impl TempoEstimator {
    pub(super) fn new(rows_per_second: f64) -> Self {
        let width = (WINDOW_SECONDS * rows_per_second) as usize;
        Self {
            rows_per_minute: 60.0 * rows_per_second,
            tempogram: Tempogram::new(width),
            mean: vec![0.0; width],
        }
    }

    /// `None` when the envelope is silent.
    pub(super) fn estimate(&mut self, onset: &[f32], goes_on: impl Fn() -> bool) -> Option<Tempo> {
        if onset.iter().all(|&strength| strength == 0.0) {
            return None;
        }
        self.mean.fill(0.0);
        let mean = &mut self.mean;
        self.tempogram.for_each_row(onset, |_, lags| {
            for (mean, lag) in mean.iter_mut().zip(lags) {
                *mean += lag / onset.len() as f64;
            }
            goes_on()
        });
        self.best_lag()
    }

    fn best_lag(&self) -> Option<Tempo> {
        let mut best: Option<(f64, Tempo)> = None;
        for (period, mean) in self.mean.iter().enumerate().skip(1) {
            let bpm = self.rows_per_minute / period as f64;
            if bpm >= FASTEST_BPM {
                continue;
            }
            let octaves = (bpm / EXPECTED_BPM).log2();
            let score = (1e6 * mean).ln_1p() - 0.5 * octaves * octaves;
            if best.is_none_or(|(highest, _)| score > highest) {
                best = Some((score, Tempo { period, bpm }));
            }
        }
        best.map(|(_, tempo)| tempo)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regular_onsets_give_their_own_tempo() {
        for (rows_per_second, period) in [(7.5, 4), (60.0, 32)] {
            let onset: Vec<f32> = (0..700)
                .map(|i| if i % period == 1 { 3.0 } else { 0.0 })
                .collect();
            let tempo = TempoEstimator::new(rows_per_second).estimate(&onset, || true);
            let bpm = 60.0 * rows_per_second / period as f64;
            assert_eq!(tempo, Some(Tempo { period, bpm }));
        }
    }

    #[test]
    fn silence_has_no_tempo() {
        assert_eq!(TempoEstimator::new(7.5).estimate(&[0.0; 50], || true), None);
    }

    #[test]
    fn lags_faster_than_320_bpm_are_out() {
        let mut estimator = TempoEstimator::new(60.0);
        estimator.mean.fill(0.0);
        estimator.mean[11] = 1.0;
        estimator.mean[12] = 0.9;
        assert_eq!(estimator.best_lag().map(|tempo| tempo.period), Some(12));
    }
}
