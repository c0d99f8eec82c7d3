//! What a song's style shows in: timbre and how it changes, harmony, tempo. A few numbers a song,
//! as there are few songs to learn styles from.

use std::ops::Range;

use bailando_features::{CHROMA_COLUMNS, COLUMNS, DELTA_COLUMNS, MFCC_COLUMNS, TEMPOGRAM_COLUMNS};
use ndarray::ArrayView2;

/// MFCC whose correlations are taken: those of pitch and loudness apart, the coarsest.
const CORRELATED: Range<usize> = 1..13;
/// Bands of the tempogram's lags, each wider than the one before by the same factor.
const BANDS: usize = 16;
/// Where the first of them begins, in rows.
const FIRST_LAG: f64 = 2.0;
/// Number of [`song_statistics`]: of the MFCC means, spreads, spreads of the slopes and
/// correlations; of the chroma the mean of each rank and one spread; means of the tempogram's
/// bands.
pub const STATISTICS: usize =
    3 * MFCC_COLUMNS.end + PAIRS + CHROMA_COLUMNS.end - CHROMA_COLUMNS.start + 1 + BANDS;
/// Pairs of the correlated MFCC.
const PAIRS: usize = {
    let count = CORRELATED.end - CORRELATED.start;
    count * (count - 1) / 2
};

/// Returns the statistics of a song's feature rows `[rows, 438 or more]`, [`STATISTICS`] of them;
/// zeros without rows or with fewer columns.
#[must_use]
pub fn song_statistics(rows: ArrayView2<'_, f32>) -> Vec<f32> {
    if rows.nrows() == 0 || rows.ncols() < COLUMNS {
        return vec![0.0; STATISTICS];
    }
    let columns: Vec<Column> = (0..COLUMNS).map(|column| Column::of(rows, column)).collect();
    let means = |range: Range<usize>| columns[range].iter().map(|column| column.mean);
    let spreads = |range: Range<usize>| columns[range].iter().map(|column| column.spread);
    let mut all: Vec<f64> = means(MFCC_COLUMNS).collect();
    all.extend(spreads(MFCC_COLUMNS));
    all.extend(spreads(DELTA_COLUMNS));
    all.extend(chroma_ranks(rows));
    all.push(mean(&spreads(CHROMA_COLUMNS).collect::<Vec<_>>()));
    let tempogram: Vec<f64> = means(TEMPOGRAM_COLUMNS).collect();
    all.extend(bands(tempogram.len()).map(|band| mean(&tempogram[band])));
    for first in CORRELATED {
        all.extend((first + 1..CORRELATED.end).map(|second| {
            let pair = [first, second];
            correlation(rows, pair, pair.map(|column| &columns[column]))
        }));
    }
    all.into_iter().map(|value| value as f32).collect()
}

/// Mean and spread of a column.
struct Column {
    mean: f64,
    spread: f64,
}

impl Column {
    fn of(rows: ArrayView2<'_, f32>, column: usize) -> Self {
        let values: Vec<f64> = rows.column(column).iter().map(|&value| f64::from(value)).collect();
        let middle = mean(&values);
        let squares: Vec<f64> = values.iter().map(|value| (value - middle).powi(2)).collect();
        Self { mean: middle, spread: mean(&squares).sqrt() }
    }
}

/// Means of the weakest to the strongest chroma of each row: how tonal a song is, in any key.
fn chroma_ranks(rows: ArrayView2<'_, f32>) -> impl Iterator<Item = f64> {
    let mut sums = [0.0; CHROMA_COLUMNS.end - CHROMA_COLUMNS.start];
    for row in rows.rows() {
        let mut chroma: Vec<f32> = CHROMA_COLUMNS.map(|column| row[column]).collect();
        chroma.sort_by(f32::total_cmp);
        for (sum, value) in sums.iter_mut().zip(chroma) {
            *sum += f64::from(value);
        }
    }
    let count = rows.nrows() as f64;
    sums.into_iter().map(move |sum| sum / count)
}

/// The bands of so many lags.
fn bands(lags: usize) -> impl Iterator<Item = Range<usize>> {
    let edge = move |number: usize| {
        let ratio = lags as f64 / FIRST_LAG;
        (FIRST_LAG * ratio.powf(number as f64 / BANDS as f64)).round() as usize
    };
    (0..BANDS).map(move |band| edge(band)..edge(band + 1))
}

/// Correlation of two columns; 0 where one of them does not change.
fn correlation(rows: ArrayView2<'_, f32>, [a, b]: [usize; 2], [x, y]: [&Column; 2]) -> f64 {
    let products = rows
        .rows()
        .into_iter()
        .map(|row| (f64::from(row[a]) - x.mean) * (f64::from(row[b]) - y.mean));
    let scale = rows.nrows() as f64 * x.spread * y.spread;
    match scale > 0.0 {
        true => products.sum::<f64>() / scale,
        false => 0.0,
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;

    #[test]
    fn bands_cover_the_lags_and_widen() {
        let bands: Vec<Range<usize>> = bands(384).collect();
        assert_eq!((bands[0].start, bands[15].end), (2, 384));
        assert!(bands.windows(2).all(|pair| pair[0].end == pair[1].start));
        assert!(bands.iter().all(|band| !band.is_empty()));
        assert!(bands.windows(2).all(|pair| pair[0].len() <= pair[1].len() + 1), "{bands:?}");
    }

    #[test]
    fn statistics_are_those_of_the_columns() {
        // The first MFCC rise, the odd ones fall; chroma are 0 to 11 in another order a row.
        let rows = Array2::from_shape_fn((4, COLUMNS + 2), |(row, column)| match column {
            0..20 => (row as f32 - 1.5) * if column % 2 == 0 { 1.0 } else { -2.0 } + column as f32,
            40..52 => ((column * 5 + row) % 12) as f32,
            54.. => (column - 54) as f32,
            _ => 0.0,
        });
        let found = song_statistics(rows.view());
        assert_eq!(found.len(), STATISTICS);
        let spread = 1.25_f32.sqrt();
        assert_eq!((found[0], found[7], found[20], found[40]), (0.0, 7.0, spread, 0.0));
        assert!((found[21] - 2.0 * spread).abs() < 1e-6);
        let ranks: Vec<f32> = (0..12_u8).map(f32::from).collect();
        assert_eq!(found[60..72], ranks);
        assert!(found[72] > 1.0, "chroma change");
        // The first band holds lag 2 alone, the last ends with 383.
        assert_eq!(found[73], 2.0);
        let correlations = &found[STATISTICS - PAIRS..];
        // Of 1 with 2, 3 and 4.
        for (found, wanted) in correlations.iter().zip([-1.0, 1.0, -1.0]) {
            assert!((found - wanted).abs() < 1e-6, "{correlations:?}");
        }
    }

    #[test]
    fn nothing_gives_zeros() {
        for rows in [Array2::zeros((0, COLUMNS)), Array2::zeros((3, 7))] {
            assert_eq!(song_statistics(rows.view()), [0.0; STATISTICS]);
        }
        let still = Array2::from_elem((3, COLUMNS), 2.0);
        assert!(song_statistics(still.view()).iter().all(|value| value.is_finite()));
    }
}
