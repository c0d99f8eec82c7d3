//! Checks that several sections of the settings share.

use std::ops::RangeBounds;

/// Adds the place in the file to a mistake.
pub(super) fn within(place: &str, checked: Result<(), String>) -> Result<(), String> {
    checked.map_err(|mistake| format!("{place}{mistake}"))
}

/// Refuses sizes of 0.
pub(super) fn at_least_one<const N: usize>(sizes: [(&str, usize); N]) -> Result<(), String> {
    match sizes.into_iter().find(|&(_, size)| size == 0) {
        Some((name, _)) => Err(format!("{name} must be at least 1")),
        None => Ok(()),
    }
}

/// Refuses numbers below 0, infinities and NaN.
pub(super) fn not_negative<const N: usize>(numbers: [(&str, f64); N]) -> Result<(), String> {
    let wrong = |&(_, value): &(&str, f64)| !(value >= 0.0 && value.is_finite());
    match numbers.into_iter().find(wrong) {
        Some((name, value)) => Err(format!("{name} ({value}) must be a number of 0 or more")),
        None => Ok(()),
    }
}

/// Refuses numbers outside a range.
pub(super) fn within_range<const N: usize>(
    numbers: [(&str, f64); N],
    range: impl RangeBounds<f64>,
    text: &str,
) -> Result<(), String> {
    match numbers.into_iter().find(|(_, value)| !range.contains(value)) {
        Some((name, value)) => Err(format!("{name} ({value}) must lie in {text}")),
        None => Ok(()),
    }
}
