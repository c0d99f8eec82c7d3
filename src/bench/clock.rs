//! Wall-clock times.

use std::time::Instant;

/// What `work` gives, and how many seconds it took.
pub(super) fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let started = Instant::now();
    let result = work();
    (result, started.elapsed().as_secs_f64())
}

/// Median seconds of `repeats` times `work`, after one time that does not count.
pub(super) fn median<T, E>(
    repeats: usize,
    mut work: impl FnMut() -> Result<T, E>,
) -> Result<f64, E> {
    work()?;
    let times = (0..repeats.max(1)).map(|_| {
        let (result, seconds) = timed(&mut work);
        result.map(|_| seconds)
    });
    Ok(quantile(times.collect::<Result<_, E>>()?, 0.5))
}

/// The value below which a share of `values` lies, the nearest one; not a number if there are none.
pub(super) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (share * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(place).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_of_the_list() {
        let values = vec![3.0, 1.0, 2.0, 5.0, 4.0];
        assert_eq!(quantile(values.clone(), 0.0), 1.0);
        assert_eq!(quantile(values.clone(), 0.5), 3.0);
        assert_eq!(quantile(values, 0.95), 5.0);
        assert!(quantile(Vec::new(), 0.5).is_nan());
    }
}
