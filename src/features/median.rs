//! Medians: of a window that slides, and of a list.

/// Length of the sliding window.
pub(super) const WINDOW: usize = 31;

/// The last [`WINDOW`] values in ascending order; one value is exchanged per step.
#[derive(Clone, Debug)]
pub(super) struct SlidingMedian {
    // One more entry, always infinite, spares the shift below a special case.
    sorted: [f32; WINDOW + 1],
}

impl SlidingMedian {
    pub(super) fn new() -> Self {
        Self {
            sorted: [f32::INFINITY; WINDOW + 1],
        }
    }

    /// Starts over with these values.
    pub(super) fn fill(&mut self, values: impl Iterator<Item = f32>) {
        for (slot, value) in self.sorted[..WINDOW].iter_mut().zip(values) {
            *slot = value;
        }
        self.sorted[..WINDOW].sort_unstable_by(f32::total_cmp);
    }

    /// Replaces `old`, which has to be in the window, by `new`.
    ///
    /// Branch-free over the whole window, so that it becomes a few vector instructions.
    pub(super) fn exchange(&mut self, old: f32, new: f32) {
        let mut without_old = [f32::INFINITY; WINDOW];
        for (i, slot) in without_old.iter_mut().enumerate() {
            let (here, next) = (self.sorted[i], self.sorted[i + 1]);
            *slot = if here < old { here } else { next };
        }
        self.sorted[0] = lower(new, without_old[0]);
        for i in 1..WINDOW {
            self.sorted[i] = lower(upper(without_old[i - 1], new), without_old[i]);
        }
    }

    pub(super) fn median(&self) -> f32 {
        self.sorted[WINDOW / 2]
    }
}

// `f32::min` and `f32::max` also sort out NaN, at a price; there is none here.
fn lower(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

fn upper(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The two values in the middle of the sorted list (twice the same for an odd count), whose mean is
/// the median; `None` for an empty list. The list is reordered.
pub(super) fn middle_two<T: Copy>(
    values: &mut [T],
    order: impl Fn(&T, &T) -> std::cmp::Ordering,
) -> Option<(T, T)> {
    if values.is_empty() {
        return None;
    }
    let (middle, is_even) = (values.len() / 2, values.len().is_multiple_of(2));
    let (below, upper, _) = values.select_nth_unstable_by(middle, &order);
    let upper = *upper;
    let lower = if is_even {
        below.iter().copied().max_by(order)
    } else {
        None
    };
    Some((lower.unwrap_or(upper), upper))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn sliding_equals_sorting(values in prop::collection::vec(0_u8..12, WINDOW..200)) {
            // Few distinct values: repeated ones are the hard case.
            let values: Vec<f32> = values.into_iter().map(f32::from).collect();
            let mut sliding = SlidingMedian::new();
            sliding.fill(values.iter().copied());
            for (start, window) in values.windows(WINDOW).enumerate() {
                if start > 0 {
                    sliding.exchange(values[start - 1], values[start + WINDOW - 1]);
                }
                let mut sorted = window.to_vec();
                sorted.sort_by(f32::total_cmp);
                prop_assert_eq!(sliding.median(), sorted[WINDOW / 2]);
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
