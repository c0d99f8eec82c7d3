//! Medians: of windows that slide, and of a list.

use pulp::{Arch, Simd, WithSimd};

/// Length of the sliding window.
pub(crate) const WINDOW: usize = 31;

/// Divisor of the number of windows that slide side by side: whole vectors on every machine.
pub(crate) const LANES: usize = 16;

/// The last [`WINDOW`] values of each of several windows, in ascending order; each step exchanges
/// one value per window.
#[derive(Clone, Debug)]
pub(crate) struct SlidingMedians {
    windows: usize,
    /// The values that the first ones replace.
    infinite: Vec<f32>,
    /// The values of all windows rank by rank. One more rank, always infinite, saves a special
    /// case.
    sorted: Vec<f32>,
}

impl SlidingMedians {
    /// Makes `windows` windows, a multiple of [`LANES`], that wait for [`WINDOW`] values each.
    pub(crate) fn new(windows: usize) -> Self {
        Self {
            windows,
            infinite: vec![f32::INFINITY; windows],
            sorted: vec![f32::INFINITY; (WINDOW + 1) * windows],
        }
    }

    /// Starts over with `values(0..WINDOW)`, each of one value per window.
    pub(crate) fn fill<V: AsRef<[f32]>>(&mut self, values: impl Fn(usize) -> V) {
        self.sorted.fill(f32::INFINITY);
        for index in 0..WINDOW {
            let (sorted, old) = (&mut self.sorted, &self.infinite);
            let new = values(index);
            let new = new.as_ref();
            Arch::new().dispatch(Exchange { sorted, old, new });
        }
    }

    /// Replaces the values `old`, which must be in their windows, by `new`.
    pub(crate) fn exchange(&mut self, old: &[f32], new: &[f32]) {
        let sorted = &mut self.sorted;
        Arch::new().dispatch(Exchange { sorted, old, new });
    }

    /// The median of each window.
    pub(crate) fn medians(&self) -> &[f32] {
        let middle = WINDOW / 2 * self.windows;
        &self.sorted[middle..middle + self.windows]
    }
}

struct Exchange<'a> {
    sorted: &'a mut [f32],
    old: &'a [f32],
    new: &'a [f32],
}

impl WithSimd for Exchange<'_> {
    type Output = ();

    /// Passes every value by every rank, without branches.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (old, _) = S::as_simd_f32s(self.old);
        let (new, _) = S::as_simd_f32s(self.new);
        let (sorted, _) = S::as_mut_simd_f32s(self.sorted);
        let width = old.len();
        for (window, (&old, &new)) in old.iter().zip(new).enumerate() {
            let mut below = simd.splat_f32s(f32::NEG_INFINITY);
            let mut here = sorted[window];
            for rank in 0..WINDOW {
                let next = sorted[(rank + 1) * width + window];
                let without_old = simd.select_f32s(simd.less_than_f32s(here, old), here, next);
                sorted[rank * width + window] =
                    simd.min_f32s(simd.max_f32s(below, new), without_old);
                below = without_old;
                here = next;
            }
        }
    }
}

/// Returns the two values in the middle of the sorted list (twice the same for an odd count), whose
/// mean is the median; `None` for an empty list. Reorders the list.
pub(crate) fn middle_two<T: Copy>(
    values: &mut [T],
    order: impl Fn(&T, &T) -> std::cmp::Ordering,
) -> Option<(T, T)> {
    if values.is_empty() {
        return None;
    }
    let (middle, is_even) = (values.len() / 2, values.len().is_multiple_of(2));
    let (below, upper, _) = values.select_nth_unstable_by(middle, &order);
    let upper = *upper;
    let lower = below.iter().copied().max_by(order).filter(|_| is_even);
    Some((lower.unwrap_or(upper), upper))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn sliding_equals_sorting(values in prop::collection::vec(0_u8..12, WINDOW..200)) {
            // Few distinct values: repeated ones are the hard case. Each window has its own
            // sequence.
            let lanes = |index: usize| -> [f32; LANES] {
                std::array::from_fn(|lane| f32::from(values[(index + 7 * lane) % values.len()]))
            };
            let mut sliding = SlidingMedians::new(LANES);
            sliding.fill(|_| [3.0; LANES]);
            sliding.fill(lanes);
            for start in 0..=values.len() - WINDOW {
                if start > 0 {
                    sliding.exchange(&lanes(start - 1), &lanes(start + WINDOW - 1));
                }
                for (lane, &median) in sliding.medians().iter().enumerate() {
                    let window = start..start + WINDOW;
                    let mut sorted: Vec<f32> = window.map(|index| lanes(index)[lane]).collect();
                    sorted.sort_by(f32::total_cmp);
                    prop_assert_eq!(median, sorted[WINDOW / 2]);
                }
            }
        }

        #[test]
        fn middle_two_equals_sorting(values in prop::collection::vec(-5.0_f32..5.0, 1..60)) {
            let mut sorted = values.clone();
            sorted.sort_by(f32::total_cmp);
            let n = sorted.len();
            let expected = (sorted[(n - 1) / 2], sorted[n / 2]);
            let mut values = values;
            prop_assert_eq!(middle_two(&mut values, f32::total_cmp), Some(expected));
        }
    }

    #[test]
    fn nothing_has_no_median() {
        assert_eq!(middle_two(&mut [], f32::total_cmp), None);
    }
}
