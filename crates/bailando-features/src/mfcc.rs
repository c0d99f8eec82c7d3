//! Mel-frequency cepstrum and its slope over time (FEATURES section 3).

use std::f64::consts::PI;

use ndarray::{ArrayRef1, ArrayRef2};

use crate::mel::BANDS;

/// Coefficients kept.
pub(crate) const COEFFICIENTS: usize = 20;

/// The first rows of the orthonormal DCT-II over the mel bands.
pub(crate) struct Mfcc {
    basis: Vec<[f64; BANDS]>,
}

impl Mfcc {
    pub(crate) fn new() -> Self {
        let row = |k: usize| {
            let energy = if k == 0 { 1.0 } else { 2.0 };
            let scale = (energy / BANDS as f64).sqrt();
            std::array::from_fn(|n| {
                scale * (PI * (k * (2 * n + 1)) as f64 / (2 * BANDS) as f64).cos()
            })
        };
        Self { basis: (0..COEFFICIENTS).map(row).collect() }
    }

    /// Writes the coefficients of one frame of mel decibels.
    pub(crate) fn frame<'out>(
        &self,
        mel_db: &ArrayRef1<f32>,
        coefficients: impl IntoIterator<Item = &'out mut f32>,
    ) {
        for (coefficient, basis) in coefficients.into_iter().zip(&self.basis) {
            let sum: f64 =
                basis.iter().zip(mel_db).map(|(weight, &db)| weight * f64::from(db)).sum();
            *coefficient = sum as f32;
        }
    }
}

/// Writes the slope over three rows of `[T, n]` values (Savitzky-Golay, degree 1); the first and
/// the last row repeat their neighbours. `T` is at least 3.
pub(crate) fn delta(values: &ArrayRef2<f32>, slopes: &mut ArrayRef2<f32>) {
    let rows = values.nrows();
    for row in 0..rows {
        let middle = row.clamp(1, rows - 2);
        for column in 0..values.ncols() {
            let rise = values[[middle + 1, column]] - values[[middle - 1, column]];
            slopes[[row, column]] = rise / 2.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, array, aview1};

    use super::*;

    #[test]
    fn a_constant_and_a_cosine_give_one_coefficient_each() {
        let mfcc = Mfcc::new();
        let mut got = [0.0; COEFFICIENTS];
        mfcc.frame(&aview1(&[-8.0; BANDS]), &mut got);
        assert!((got[0] + 8.0 * 128.0_f32.sqrt()).abs() < 1e-4);
        assert!(got[1..].iter().all(|c| c.abs() < 1e-5));

        let cosine: Vec<f32> =
            (0..BANDS).map(|n| (PI * 5.0 * (2 * n + 1) as f64 / 256.0).cos() as f32).collect();
        mfcc.frame(&aview1(&cosine), &mut got);
        // Orthonormal rows: the cosine's norm is sqrt(64).
        assert!((got[5] - 8.0).abs() < 1e-5);
        let mut others = got.iter().enumerate().filter(|&(k, _)| k != 5);
        assert!(others.all(|(_, c)| c.abs() < 1e-5));
    }

    #[test]
    fn slopes_are_central_and_repeat_at_the_edges() {
        let values = array![[0.0], [1.0], [4.0], [9.0]];
        let mut slopes = Array2::zeros((4, 1));
        delta(&values, &mut slopes);
        assert_eq!(slopes, array![[2.0], [2.0], [4.0], [4.0]]);
    }
}
