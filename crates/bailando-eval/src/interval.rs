//! Confidence intervals of a mean over a few seeds.

/// Two-sided 95 % quantiles of Student's t for 1 to 10 degrees of freedom.
const FEW: [f64; 10] = [
    12.706_2, 4.302_65, 3.182_45, 2.776_45, 2.570_58, 2.446_91, 2.364_62, 2.306, 2.262_16, 2.228_14,
];
/// The same quantile of the normal distribution.
const MANY: f64 = 1.959_964;

/// Returns the mean, and half the width of its 95 % confidence interval (Student's t); none of no
/// values, no width of a single one.
pub(crate) fn mean_and_margin(values: &[f64]) -> Option<(f64, Option<f64>)> {
    if values.is_empty() {
        return None;
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    if values.len() == 1 {
        return Some((mean, None));
    }
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    let error = (squares / (count - 1.0) / count).sqrt();
    Some((mean, Some(quantile(values.len() - 1) * error)))
}

fn quantile(degrees: usize) -> f64 {
    match FEW.get(degrees - 1) {
        Some(&quantile) => quantile,
        None => {
            // The first terms of the Cornish-Fisher expansion; within 5e-4 from 11 degrees on.
            let (z, n) = (MANY, degrees as f64);
            let second = 5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z;
            let third = 3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z;
            z + (z.powi(3) + z) / (4.0 * n) + second / (96.0 * n * n) + third / (384.0 * n.powi(3))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_students() {
        // Sample deviation 1, three values: 4.30265 / sqrt(3).
        let (mean, margin) = mean_and_margin(&[4.0, 5.0, 6.0]).unwrap();
        assert!((mean - 5.0).abs() < 1e-12);
        assert!((margin.unwrap() - 2.484_14).abs() < 1e-4);
        assert_eq!(mean_and_margin(&[2.5]), Some((2.5, None)));
        assert_eq!(mean_and_margin(&[]), None);
    }

    #[test]
    fn quantiles_are_those_of_tables() {
        let table = [(1, 12.706), (10, 2.228), (11, 2.201), (20, 2.086), (60, 2.000)];
        for (degrees, expected) in table {
            assert!((quantile(degrees) - expected).abs() < 6e-4, "{degrees}");
        }
    }
}
