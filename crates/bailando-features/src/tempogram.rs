//! Local autocorrelation of the onset envelope (FEATURES section 9).

use bailando_core::CancelToken;
use rustfft::num_complex::Complex;

use crate::{
    fft::{ForwardFft, InverseFft},
    stft::hann_periodic,
};

/// Autocorrelation under a window that slides over the envelope row by row.
pub(crate) struct Tempogram {
    window: Vec<f64>,
    forward: ForwardFft,
    inverse: InverseFft,
    transform_length: usize,
    padded: Vec<f64>,
    lags: Vec<f64>,
}

impl Tempogram {
    /// Plans a window of `width` rows (even) and as many lags.
    pub(crate) fn new(width: usize) -> Self {
        // Long enough that the ends do not wrap into each other.
        let transform_length = 2 * width;
        Self {
            window: hann_periodic(width),
            forward: ForwardFft::new(transform_length),
            inverse: InverseFft::new(transform_length),
            transform_length,
            padded: Vec::new(),
            lags: vec![0.0; width],
        }
    }

    /// Shows each row's lags `0..width`, relative to the largest, to `visit`, until `cancel` is
    /// triggered.
    pub(crate) fn for_each_row(
        &mut self,
        onset: &[f32],
        cancel: &CancelToken,
        mut visit: impl FnMut(usize, &[f64]),
    ) {
        self.pad(onset);
        for row in (0..onset.len()).take_while(|_| !cancel.is_cancelled()) {
            self.correlate(row);
            visit(row, &self.lags);
        }
    }

    /// Puts straight ramps from and to silence at both ends, each half a window long.
    fn pad(&mut self, onset: &[f32]) {
        let ramp = self.window.len() / 2;
        let first = onset.first().copied().map_or(0.0, f64::from);
        let last = onset.last().copied().map_or(0.0, f64::from);
        let share = |k: usize| k as f64 / ramp as f64;
        self.padded.clear();
        self.padded.extend((0..ramp).map(|k| first * share(k)));
        self.padded.extend(onset.iter().copied().map(f64::from));
        self.padded.extend((0..ramp).rev().map(|k| last * share(k)));
    }

    fn correlate(&mut self, row: usize) {
        let width = self.window.len();
        let input = self.forward.input();
        input.fill(0.0);
        let weighted = self.padded[row..row + width].iter().zip(&self.window);
        for (input, (value, weight)) in input.iter_mut().zip(weighted) {
            *input = value * weight;
        }
        for (power, bin) in self.inverse.input().iter_mut().zip(self.forward.run()) {
            *power = Complex::new(bin.norm_sqr(), 0.0);
        }
        let scale = 1.0 / self.transform_length as f64;
        let correlation = self.inverse.run();
        for (lag, value) in self.lags.iter_mut().zip(correlation) {
            *lag = value * scale;
        }
        let sizes = self.lags.iter().map(|lag| lag.abs());
        let largest = sizes.fold(0.0_f64, f64::max);
        if largest >= f64::MIN_POSITIVE {
            for lag in &mut self.lags {
                *lag /= largest;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_equals_the_direct_autocorrelation() {
        let strength = |i: usize| {
            if i % 7 == 3 { 2.0 + (i as f32).sin() } else { 0.1 }
        };
        let onset: Vec<f32> = (0..90).map(strength).collect();
        for width in [60, 384] {
            let half = width / 2;
            let padded = |i: usize| {
                if i < half {
                    f64::from(onset[0]) * i as f64 / half as f64
                } else if i < half + 90 {
                    f64::from(onset[i - half])
                } else {
                    f64::from(onset[89]) * (2 * half + 89 - i) as f64 / half as f64
                }
            };
            let window = hann_periodic(width);
            let mut rows = 0;
            Tempogram::new(width).for_each_row(&onset, &CancelToken::new(), |row, lags| {
                rows += 1;
                let frame: Vec<f64> = (0..width).map(|n| padded(row + n) * window[n]).collect();
                let direct: Vec<f64> = (0..width)
                    .map(|lag| (lag..width).map(|n| frame[n] * frame[n - lag]).sum())
                    .collect();
                assert_eq!(lags.len(), width);
                for (lag, value) in lags.iter().enumerate() {
                    let expected = direct[lag] / direct[0];
                    assert!((value - expected).abs() < 1e-12, "row {row}, lag {lag}");
                }
            });
            assert_eq!(rows, 90);
        }
    }

    #[test]
    fn silence_stays_zero() {
        Tempogram::new(60).for_each_row(&[0.0; 5], &CancelToken::new(), |_, lags| {
            assert!(lags.iter().all(|&lag| lag == 0.0));
        });
    }
}
