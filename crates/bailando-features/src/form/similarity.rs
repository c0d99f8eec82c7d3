//! Which parts of a piece are alike.

use ndarray::{Array2, Array3, Axis};

/// How much each two parts of a piece are alike: of its music, or of a dance.
#[derive(Clone, Debug)]
pub struct SelfSimilarity(Array2<f32>);

impl SelfSimilarity {
    /// Compares `parts` (`[parts, moments, columns]`): the cosine of each two, of what makes them
    /// differ from the mean part, in units of each column's standard deviation. What goes through
    /// the whole piece says nothing.
    #[must_use]
    pub fn new(parts: &Array3<f32>) -> Self {
        let (number, moments, columns) = parts.dim();
        let spreads: Vec<f32> = parts.axis_iter(Axis(2)).map(|column| column.std(0.0)).collect();
        let mut values = parts.as_standard_layout().into_owned();
        if let Some(mean) = parts.mean_axis(Axis(0)) {
            values -= &mean;
        }
        for (mut column, spread) in values.axis_iter_mut(Axis(2)).zip(spreads) {
            if spread > 0.0 {
                column /= spread;
            }
        }
        let mut rows = values
            .into_shape_with_order((number, moments * columns))
            .unwrap_or_else(|_| unreachable!("the same number of values"));
        for mut row in rows.rows_mut() {
            let length = row.dot(&row).sqrt();
            if length > 0.0 {
                row /= length;
            }
        }
        Self(rows.dot(&rows.t()))
    }

    /// Returns the number of parts.
    #[must_use]
    pub fn parts(&self) -> usize {
        self.0.nrows()
    }

    /// Returns the likeness of two parts, from -1 to 1.
    ///
    /// # Panics
    /// If there is no such part.
    #[must_use]
    pub fn of(&self, one: usize, other: usize) -> f64 {
        f64::from(self.0[[one, other]])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_all_parts_share_says_nothing() {
        // Four parts of two moments: a column that is the same in all, and one that is not.
        let differs = [[1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, 1.0]];
        let parts = Array3::from_shape_fn((4, 2, 2), |(part, moment, column)| match column {
            0 => 100.0 + moment as f32,
            _ => 5.0 + differs[part][moment],
        });
        let similar = SelfSimilarity::new(&parts);
        assert_eq!(similar.parts(), 4);
        for (one, other, expected) in [(0, 0, 1.0), (0, 1, -1.0), (0, 2, 1.0), (3, 1, 1.0)] {
            assert!((similar.of(one, other) - expected).abs() < 1e-6, "{one} {other}");
        }
        assert_eq!(SelfSimilarity::new(&Array3::zeros((0, 8, 32))).parts(), 0);
        assert_eq!(SelfSimilarity::new(&Array3::zeros((3, 8, 2))).of(0, 1), 0.0);
    }
}
