//! Changes of harmony.

use ndarray::ArrayView2;

use crate::layout::Rate;

/// Rows on either side of a moment that are compared: about one count at 180 a minute.
const ROWS: usize = 3;

/// Change of harmony at a moment: 1 less the cosine of the mean chroma `[rows, 12]` on both sides.
pub(crate) fn novelty(chroma: ArrayView2<'_, f32>, seconds: f64) -> f64 {
    let row = (seconds * Rate::Conditioning.rows_per_second()).round();
    let row = row.max(0.0) as usize;
    let sum = |from: usize, to: usize| {
        let mut sum = [0.0_f64; 12];
        for row in from..to.min(chroma.nrows()) {
            for (sum, &value) in sum.iter_mut().zip(chroma.row(row)) {
                *sum += f64::from(value);
            }
        }
        sum
    };
    let before = sum(row.saturating_sub(ROWS), row);
    let after = sum(row, row + ROWS);
    let dot = |a: &[f64; 12], b: &[f64; 12]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let lengths = (dot(&before, &before) * dot(&after, &after)).sqrt();
    if lengths > 0.0 { 1.0 - dot(&before, &after) / lengths } else { 0.0 }
}
