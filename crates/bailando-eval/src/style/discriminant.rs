//! Linear discriminant analysis with a shrunk covariance: the classes are taken for normal
//! distributions of one shape, which a few hundred windows are enough to measure.

use nalgebra::{Cholesky, DMatrix, DVector};

/// Share of the mean variance that is mixed into the covariance: recordings are few, and windows of
/// one take alike.
const SHRINKAGE: f64 = 0.1;
/// Deviation below which a column is constant.
const CONSTANT: f64 = 1e-9;

/// Tells classes apart by linear scores.
#[derive(Clone, Debug)]
pub(super) struct Discriminant {
    mean: DVector<f64>,
    deviation: DVector<f64>,
    /// `[columns, classes]`.
    weights: DMatrix<f64>,
    bias: DVector<f64>,
}

impl Discriminant {
    /// Learns from the rows of each class. Classes count alike, however many rows they have.
    ///
    /// # Panics
    /// If a class has no rows.
    pub(super) fn new<const N: usize>(classes: &[Vec<[f64; N]>]) -> Self {
        assert!(classes.iter().all(|rows| !rows.is_empty()), "every class has rows");
        let all = classes.iter().flatten();
        let mean = mean(all.clone());
        let deviation = deviation(all, &mean);
        let standard =
            |row: &[f64; N]| (DVector::from_column_slice(row) - &mean).component_div(&deviation);
        let mut means = DMatrix::zeros(N, classes.len());
        let mut covariance = DMatrix::zeros(N, N);
        for (class, rows) in classes.iter().enumerate() {
            let columns: Vec<DVector<f64>> = rows.iter().map(standard).collect();
            let own = DMatrix::from_columns(&columns);
            let centre = own.column_mean();
            let centred = DMatrix::from_fn(N, rows.len(), |row, at| own[(row, at)] - centre[row]);
            covariance += &centred * centred.transpose() / (rows.len() * classes.len()) as f64;
            means.set_column(class, &centre);
        }
        let variance = covariance.trace() / N as f64;
        let even = DMatrix::identity(N, N) * (SHRINKAGE * variance + f64::EPSILON);
        #[expect(
            clippy::expect_used,
            reason = "a share of the identity makes it positive definite"
        )]
        let shape = Cholesky::new(covariance * (1.0 - SHRINKAGE) + even)
            .expect("the covariance is positive definite");
        let weights = shape.solve(&means);
        let bias = DVector::from_fn(classes.len(), |class, _| {
            -0.5 * means.column(class).dot(&weights.column(class))
        });
        Self { mean, deviation, weights, bias }
    }

    /// The class that a row most likely belongs to.
    pub(super) fn classify<const N: usize>(&self, row: &[f64; N]) -> usize {
        let row = DVector::from_column_slice(row) - &self.mean;
        let scores = self.weights.tr_mul(&row.component_div(&self.deviation)) + &self.bias;
        scores.argmax().0
    }
}

fn mean<'a, const N: usize>(rows: impl Iterator<Item = &'a [f64; N]>) -> DVector<f64> {
    let (mut sum, mut count) = (DVector::zeros(N), 0.0);
    for row in rows {
        sum += DVector::from_column_slice(row);
        count += 1.0;
    }
    sum / count
}

/// Deviation of each column, 1 where it is constant.
fn deviation<'a, const N: usize>(
    rows: impl Iterator<Item = &'a [f64; N]>,
    mean: &DVector<f64>,
) -> DVector<f64> {
    let (mut squares, mut count) = (DVector::zeros(N), 0.0);
    for row in rows {
        let centred = DVector::from_column_slice(row) - mean;
        squares += centred.component_mul(&centred);
        count += 1.0;
    }
    (squares / count).map(|square: f64| match square.sqrt() {
        constant if constant < CONSTANT => 1.0,
        deviation => deviation,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_border_of_two_classes_is_halfway_in_the_units_of_their_shape() {
        // Spread along (1, 1), apart along (1, -1), and a constant column.
        let class = |apart: f64| {
            let along = [-2.0, -1.0, 0.0, 1.0, 2.0];
            along
                .iter()
                .flat_map(|&t| [-0.1, 0.1].map(|n| [t + apart + n, t - apart - n, 7.0]))
                .collect::<Vec<_>>()
        };
        // Ten times the rows do not move the border.
        let many: Vec<[f64; 3]> = (0..10).flat_map(|_| class(0.5)).collect();
        let discriminant = Discriminant::new(&[class(-0.5), many]);
        for (row, expected) in [
            ([10.0, 10.2, 7.0], 0),
            ([10.2, 10.0, 7.0], 1),
            ([-3.0, -2.8, 7.0], 0),
            ([-2.8, -3.0, 7.0], 1),
        ] {
            assert_eq!(discriminant.classify(&row), expected, "{row:?}");
        }
    }
}
