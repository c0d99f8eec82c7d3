//! The phrases, or bars, of a song.

use ndarray::{Array3, ArrayView2};

use super::similarity::SelfSimilarity;
use crate::{
    layout::{CHROMA_COLUMNS, MFCC_COLUMNS, Rate},
    phase::BeatPhase,
};

/// Most phrases, or bars, of a song that are looked at: half an hour and more.
const MOST: usize = 1_024;
/// Moments of a count whose mean it is.
const MOMENTS: usize = 4;
/// Part of a count that a phrase may lack at the song's ends.
const LACKING: f64 = 0.05;

/// The whole phrases of a song, or its bars: as many counts each.
#[derive(Clone, Debug)]
pub struct Phrases {
    bounds_s: Vec<f64>,
    /// `[phrases, counts, columns]`.
    values: Array3<f32>,
}

impl Phrases {
    /// Cuts `rows` (`[rows, 438 or more]` at [`Rate::Conditioning`]) into phrases of `length`
    /// counts: 8, or 4 for bars.
    #[must_use]
    pub fn new(rows: ArrayView2<'_, f32>, counts: &BeatPhase, length: usize) -> Self {
        let seconds = rows.nrows() as f64 / Rate::Conditioning.rows_per_second();
        let size = length as f64;
        let first = ((counts.at(0.0) - LACKING) / size).ceil();
        let end = ((counts.at(seconds) + LACKING) / size).floor();
        let number = ((end - first).max(0.0) as usize).min(MOST);
        let bound = |phrase: usize| counts.second_of((first + phrase as f64) * size);
        let columns: Vec<usize> = MFCC_COLUMNS.chain(CHROMA_COLUMNS).collect();
        let mut values = Array3::zeros((number, length, columns.len()));
        for ((phrase, count, column), value) in values.indexed_iter_mut() {
            let start = (first + phrase as f64) * size + count as f64;
            let moments = (0..MOMENTS).map(|moment| {
                let place = (moment as f64 + 0.5) / MOMENTS as f64;
                let second = counts.second_of(start + place);
                at(rows, second * Rate::Conditioning.rows_per_second(), columns[column])
            });
            *value = moments.sum::<f32>() / MOMENTS as f32;
        }
        Self { bounds_s: (0..=number).map(bound).collect(), values }
    }

    /// Returns the seconds of the phrases' starts, and of the end of the last: one more than
    /// phrases.
    #[must_use]
    pub fn bounds_s(&self) -> &[f64] {
        &self.bounds_s
    }

    /// Compares all phrases.
    #[must_use]
    pub fn self_similarity(&self) -> SelfSimilarity {
        SelfSimilarity::new(&self.values)
    }
}

/// The value of a column between two rows; beyond the ends that of the last row.
fn at(rows: ArrayView2<'_, f32>, row: f64, column: usize) -> f32 {
    let last = rows.nrows().saturating_sub(1);
    let row = row.clamp(0.0, last as f64);
    let before = row as usize;
    let share = (row - before as f64) as f32;
    let value = |row: usize| rows[[row.min(last), column]];
    value(before) * (1.0 - share) + value(before + 1) * share
}
