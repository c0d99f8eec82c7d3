//! Wall-clock times.

use std::time::Instant;

/// Returns the result of `work` and the seconds it took.
pub(super) fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let started = Instant::now();
    let result = work();
    (result, started.elapsed().as_secs_f64())
}

/// Returns the median seconds of `repeats` times `work`, after one that does not count.
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

/// Returns the value nearest to that below which a share of `values` lies; NaN of none.
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
        let found = [0.0, 0.5, 0.95].map(|share| quantile(vec![3.0, 1.0, 2.0, 5.0, 4.0], share));
        assert_eq!(found, [1.0, 3.0, 5.0]);
        assert!(quantile(Vec::new(), 0.5).is_nan());
    }
}
