//! Smooth curves: above a jagged one, and from one value to another.

use std::{
    iter::Sum,
    ops::{Div, Mul},
};

use glam::DVec3;

/// Returns a curve nowhere below `values`, free of jumps, that departs from zero at most `2 *
/// half_width` samples away from where `values` do: the largest value near each sample, averaged
/// under a triangle as wide.
pub(crate) fn smooth_upper_bound(values: &[f64], half_width: usize) -> Vec<f64> {
    if values.iter().all(|&value| value == 0.0) {
        return values.to_vec();
    }
    (0..values.len()).map(|index| smooth_upper_bound_at(values, half_width, index)).collect()
}

/// Returns the sample `index` of [`smooth_upper_bound`], which depends on the `2 * half_width`
/// values on either side of it.
pub(crate) fn smooth_upper_bound_at(values: &[f64], half_width: usize, index: usize) -> f64 {
    let highest = |near: &[f64]| near.iter().copied().fold(f64::MIN, f64::max);
    smooth_at(values, half_width, index, highest)
}

/// Returns the sample `index` of a curve without jumps that follows the longest of `values` near
/// each sample: like [`smooth_upper_bound_at`], of vectors. Where their direction changes it is
/// shorter than they are.
pub(crate) fn smooth_largest_at(values: &[DVec3], half_width: usize, index: usize) -> DVec3 {
    let reach = 2 * half_width;
    let whole = index.saturating_sub(reach)..values.len().min(index + reach + 1);
    if values[whole].iter().all(|&value| value == DVec3::ZERO) {
        return DVec3::ZERO;
    }
    let longer = |a: DVec3, b: &DVec3| if b.length_squared() > a.length_squared() { *b } else { a };
    smooth_at(values, half_width, index, |near| near.iter().fold(DVec3::ZERO, longer))
}

/// Returns the mean, weighted as a triangle around `index`, of what `pick` takes of the values near
/// each sample.
fn smooth_at<T>(values: &[T], half_width: usize, index: usize, pick: impl Fn(&[T]) -> T) -> T
where
    T: Sum + Mul<f64, Output = T> + Div<f64, Output = T>,
{
    let near = |index: usize| {
        let end = values.len().min(index + half_width + 1);
        index.saturating_sub(half_width)..end
    };
    let weight = |other: usize| (half_width + 1 - other.abs_diff(index)) as f64;
    let weights: f64 = near(index).map(weight).sum();
    let sum: T = near(index).map(|other| pick(&values[near(other)]) * weight(other)).sum();
    sum / weights
}

/// Returns the cubic from one value and rate a frame to another in `length` frames, at frame `at`.
pub(crate) fn hermite(from: (DVec3, DVec3), to: (DVec3, DVec3), at: f64, length: f64) -> DVec3 {
    let t = at / length;
    let (t2, t3) = (t * t, t * t * t);
    from.0 * (2.0 * t3 - 3.0 * t2 + 1.0)
        + from.1 * (length * (t3 - 2.0 * t2 + t))
        + to.0 * (3.0 * t2 - 2.0 * t3)
        + to.1 * (length * (t3 - t2))
}

/// Returns 0 up to 0, 1 from 1 on, smooth between.
pub(crate) fn smooth_step(part: f64) -> f64 {
    let part = part.clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_covers_every_peak_and_has_no_jumps() {
        let mut values = vec![0.0; 200];
        (values[0], values[60], values[61], values[140]) = (0.02, 0.05, 0.01, 0.03);
        let curve = smooth_upper_bound(&values, 12);
        for (index, (curve, value)) in curve.iter().zip(&values).enumerate() {
            assert!(*curve >= value - 1e-12, "sample {index}");
        }
        for pair in curve.windows(2) {
            assert!((pair[1] - pair[0]).abs() < 0.05 / 12.0);
        }
        assert_eq!(curve[100], 0.0);
        assert!(curve[60] < 0.05 + 1e-12);
    }

    #[test]
    fn vectors_are_followed_without_jumps_where_they_turn_round() {
        let mut values = vec![DVec3::ZERO; 100];
        values[40..50].fill(DVec3::X * 0.1);
        values[50..60].fill(DVec3::X * -0.1);
        let curve: Vec<DVec3> = (0..100).map(|at| smooth_largest_at(&values, 6, at)).collect();
        assert_eq!((curve[20], curve[90]), (DVec3::ZERO, DVec3::ZERO));
        assert!(curve[44].distance(values[44]) < 1e-12 && curve[58].x < -0.05);
        for three in curve.windows(3) {
            // Two steps, by 0.2 and by 0.1, under a triangle seven wide on either side.
            let bend = (three[2] - 2.0 * three[1] + three[0]).length();
            assert!(bend < 0.3 / 7.0_f64.powi(2) + 1e-9, "{bend}");
        }
    }

    #[test]
    fn constants_stay_as_they_are() {
        assert!(smooth_upper_bound(&[], 5).is_empty());
        assert_eq!(smooth_upper_bound(&[0.0; 9], 5), [0.0; 9]);
        assert_eq!(smooth_upper_bound(&[0.3; 9], 0), [0.3; 9]);
    }
}
