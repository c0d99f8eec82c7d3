//! One tempo for the clip (FEATURES section 9).

use bailando_core::CancelToken;

use crate::tempogram::Tempogram;

const WINDOW_SECONDS: f64 = 8.0;
const EXPECTED_BPM: f64 = 120.0;
const FASTEST_BPM: f64 = 320.0;

/// Estimator of the tempo: the mean tempogram of the clip, its lags weighted by how usual they are.
pub(crate) struct TempoEstimator {
    rows_per_minute: f64,
    tempogram: Tempogram,
    mean: Vec<f64>,
}

/// The beat period of a clip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Tempo {
    /// Rows per beat.
    pub(crate) period: usize,
    pub(crate) bpm: f64,
}

impl TempoEstimator {
    pub(crate) fn new(rows_per_second: f64) -> Self {
        let width = (WINDOW_SECONDS * rows_per_second) as usize;
        Self {
            rows_per_minute: 60.0 * rows_per_second,
            tempogram: Tempogram::new(width),
            mean: vec![0.0; width],
        }
    }

    /// `None` when the envelope is silent.
    pub(crate) fn estimate(&mut self, onset: &[f32], cancel: &CancelToken) -> Option<Tempo> {
        if onset.iter().all(|&strength| strength == 0.0) {
            return None;
        }
        self.mean.fill(0.0);
        let mean = &mut self.mean;
        self.tempogram.for_each_row(onset, cancel, |_, lags| {
            for (mean, lag) in mean.iter_mut().zip(lags) {
                *mean += lag / onset.len() as f64;
            }
        });
        self.best_lag()
    }

    fn best_lag(&self) -> Option<Tempo> {
        let scored = self.mean.iter().enumerate().skip(1);
        let scored = scored.filter_map(|(period, mean)| {
            let bpm = self.rows_per_minute / period as f64;
            let octaves = (bpm / EXPECTED_BPM).log2();
            let score = (1e6 * mean).ln_1p() - 0.5 * octaves * octaves;
            (bpm < FASTEST_BPM).then_some((score, Tempo { period, bpm }))
        });
        // The shortest lag of equals.
        let best = scored.reduce(|best, next| if next.0 > best.0 { next } else { best });
        best.map(|(_, tempo)| tempo)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regular_onsets_give_their_own_tempo() {
        for (rows_per_second, period) in [(7.5, 4), (60.0, 32)] {
            let onset: Vec<f32> =
                (0..700).map(|i| if i % period == 1 { 3.0 } else { 0.0 }).collect();
            let mut estimator = TempoEstimator::new(rows_per_second);
            let tempo = estimator.estimate(&onset, &CancelToken::new());
            let bpm = 60.0 * rows_per_second / period as f64;
            assert_eq!(tempo, Some(Tempo { period, bpm }));
        }
    }

    #[test]
    fn silence_has_no_tempo() {
        let tempo = TempoEstimator::new(7.5).estimate(&[0.0; 50], &CancelToken::new());
        assert_eq!(tempo, None);
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
