//! Distances between sets of feature rows: Fréchet distance and diversity (METRICS.md,
//! "Distances").

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, ArrayView2, Axis, Zip};

/// Added to every deviation, as published.
const EPSILON: f64 = 1e-10;
/// A column that deviates less than this is constant: divided by it, rounding errors would drown
/// all other columns.
const CONSTANT: f64 = 1e-6;

/// Mean and deviation of a reference set: the units that every set is measured in.
#[derive(Clone, Debug, PartialEq)]
pub struct Standard {
    columns: Vec<usize>,
    constant: Vec<usize>,
    mean: Array1<f64>,
    deviation: Array1<f64>,
}

impl Standard {
    /// Measures reference rows `[samples, columns]`; population deviation.
    #[must_use]
    pub fn new(reference: ArrayView2<'_, f64>) -> Self {
        let samples = reference.nrows().max(1) as f64;
        let means = reference.sum_axis(Axis(0)) / samples;
        let centred = &reference - &means;
        let deviations = (centred.mapv(|v| v * v).sum_axis(Axis(0)) / samples).mapv(f64::sqrt);
        let is_constant = |&column: &usize| deviations[column] < CONSTANT;
        let (constant, columns): (Vec<_>, Vec<_>) = (0..reference.ncols()).partition(is_constant);
        Self {
            mean: means.select(Axis(0), &columns),
            deviation: deviations.select(Axis(0), &columns) + EPSILON,
            columns,
            constant,
        }
    }

    /// Columns that are constant in the reference and therefore left out of every set.
    #[must_use]
    pub fn constant_columns(&self) -> &[usize] {
        &self.constant
    }

    /// Returns rows in units of the reference's deviation, without constant columns.
    #[must_use]
    pub fn apply(&self, rows: ArrayView2<'_, f64>) -> Array2<f64> {
        (rows.select(Axis(1), &self.columns) - &self.mean) / &self.deviation
    }
}

/// Fréchet distance of two sets of rows, as if both were normally distributed:
/// `|m1 - m2|^2 + tr(S1) + tr(S2) - 2 tr((S1 S2)^(1/2))`, sample covariances.
///
/// Each set needs at least 2 rows. With fewer rows than columns the covariances are singular, where
/// a matrix root of their product is unreliable; its trace is the sum of the roots of the
/// eigenvalues of `S1^(1/2) S2 S1^(1/2)`, which is symmetric and never negative.
#[must_use]
pub fn frechet_distance(one: ArrayView2<'_, f64>, other: ArrayView2<'_, f64>) -> f64 {
    let (mean_one, covariance_one) = moments(one);
    let (mean_other, covariance_other) = moments(other);
    let root = square_root(&covariance_one);
    let product = &root * &covariance_other * &root;
    let product = (&product + product.transpose()) * 0.5;
    let shared: f64 = product.symmetric_eigenvalues().iter().map(|v| v.max(0.0).sqrt()).sum();
    let apart = (&mean_one - &mean_other).mapv(|v| v * v).sum();
    apart + covariance_one.trace() + covariance_other.trace() - 2.0 * shared
}

fn moments(rows: ArrayView2<'_, f64>) -> (Array1<f64>, DMatrix<f64>) {
    let samples = rows.nrows() as f64;
    let mean = rows.sum_axis(Axis(0)) / samples;
    let centred = &rows - &mean;
    let covariance = centred.t().dot(&centred) / (samples - 1.0);
    let columns = covariance.ncols();
    let covariance = DMatrix::from_fn(columns, columns, |row, column| covariance[(row, column)]);
    (mean, covariance)
}

/// Root of a symmetric matrix without negative eigenvalues; rounding below zero counts as zero.
fn square_root(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(matrix.clone());
    let roots = eigenvalues.map(|value| value.max(0.0).sqrt());
    &eigenvectors * DMatrix::from_diagonal(&roots) * eigenvectors.transpose()
}

/// Mean Euclidean distance of all pairs of rows; 0 for fewer than two.
#[must_use]
pub fn diversity(rows: ArrayView2<'_, f64>) -> f64 {
    let count = rows.nrows();
    if count < 2 {
        return 0.0;
    }
    let mut sum = 0.0;
    for (index, one) in rows.outer_iter().enumerate() {
        for other in rows.outer_iter().skip(index + 1) {
            let squares = Zip::from(&one).and(&other).fold(0.0, |sum, a, b| sum + (a - b).powi(2));
            sum += squares.sqrt();
        }
    }
    sum / (count * (count - 1) / 2) as f64
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;
    use crate::testing::within;

    fn close(got: f64, expected: f64) {
        within(1e-9, got, expected);
    }

    #[test]
    fn the_reference_has_mean_0_and_deviation_1_in_its_own_units() {
        let rows = array![[1.0, 5.0, 10.0], [3.0, 5.0, 30.0], [5.0, 5.0, 20.0]];
        let standard = Standard::new(rows.view());
        assert_eq!(standard.constant_columns(), [1]);
        let own = standard.apply(rows.view());
        assert_eq!(own.dim(), (3, 2));
        for column in own.columns() {
            close(column.sum(), 0.0);
            close(column.mapv(|v| v * v).sum() / 3.0, 1.0);
        }
    }

    #[test]
    fn in_one_dimension_the_distance_is_that_of_two_normal_distributions() {
        // |m1 - m2|^2 + (s1 - s2)^2 with sample deviations sqrt(2) and 3 sqrt(2).
        let one = array![[0.0], [2.0]];
        let other = array![[1.0], [7.0]];
        let root = 2.0_f64.sqrt();
        let expected = 9.0 + (root - 3.0 * root).powi(2);
        close(frechet_distance(one.view(), other.view()), expected);
    }

    #[test]
    fn turned_covariances_are_compared_as_matrices() {
        // Diagonal against its turn by 45 degrees: the root of the product's trace in closed form
        // for 2 x 2, tr(M^(1/2)) = sqrt(tr(M) + 2 sqrt(det(M))).
        let one = array![[3.0, 0.0], [-3.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
        let half = 0.5_f64.sqrt();
        let turn = array![[half, half], [-half, half]];
        let other = one.dot(&turn);
        let product: Array2<f64> = {
            let covariance = |rows: &Array2<f64>| rows.t().dot(rows) / 3.0;
            covariance(&one).dot(&covariance(&other))
        };
        let trace = product[(0, 0)] + product[(1, 1)];
        let determinant = product[(0, 0)] * product[(1, 1)] - product[(0, 1)] * product[(1, 0)];
        let expected = 2.0 * (18.0 + 2.0) / 3.0 - 2.0 * (trace + 2.0 * determinant.sqrt()).sqrt();
        close(frechet_distance(one.view(), other.view()), expected);
    }

    #[test]
    fn a_set_has_no_distance_from_itself_even_if_its_covariance_is_singular() {
        let rows = array![[1.0, 2.0, 3.0, 4.0], [2.0, 1.0, 0.0, 9.0], [5.0, 5.0, 1.0, 2.0]];
        // The root of a rounding error of 1e-16 is 1e-8.
        assert!(frechet_distance(rows.view(), rows.view()).abs() < 1e-6);
    }

    #[test]
    fn diversity_is_the_mean_distance_of_pairs() {
        let rows = array![[0.0, 0.0], [3.0, 4.0], [0.0, 8.0]];
        close(diversity(rows.view()), (5.0 + 8.0 + 5.0) / 3.0);
        close(diversity(array![[1.0]].view()), 0.0);
    }
}
