//! Checks that the unit tests share.

/// Asserts that a number is within `tolerance` of `expected`, relative above 1.
pub(crate) fn within(tolerance: f64, got: f64, expected: f64) {
    let error = (got - expected).abs();
    assert!(error < tolerance * expected.abs().max(1.0), "{got} {expected}");
}
