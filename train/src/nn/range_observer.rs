//! Ranges of the inputs of weights, for post-training quantisation.

use std::sync::{Mutex, PoisonError};

use burn_tensor::{Tensor, backend::Backend};

use super::host::values;

/// The least and the largest inputs of tensors, added up over passes.
///
/// Means ignore rare extremes: one number in a million would cost all others their precision.
#[derive(Debug)]
pub(super) struct RangeObserver {
    seen: Mutex<Vec<Seen>>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    least: f64,
    largest: f64,
    passes: u32,
}

impl RangeObserver {
    /// Observes this many tensors, none of which has been used.
    pub(super) fn new(tensors: usize) -> Self {
        Self { seen: Mutex::new(vec![Seen::default(); tensors]) }
    }

    /// Records a tensor's next input.
    pub(super) fn record<B: Backend, const D: usize>(&self, tensor: usize, input: &Tensor<B, D>) {
        let input = values(input);
        let [least, largest] =
            input.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[least, largest], &x| {
                [least.min(x), largest.max(x)]
            });
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(seen) = seen.get_mut(tensor) {
            seen.least += f64::from(least);
            seen.largest += f64::from(largest);
            seen.passes += 1;
        }
    }

    /// Returns the mean least and largest input of every tensor; `None` where it was not used.
    pub(super) fn ranges(&self) -> Vec<Option<[f32; 2]>> {
        let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let mean = |seen: &Seen| {
            let mean = |sum: f64| (sum / f64::from(seen.passes)) as f32;
            (seen.passes > 0).then(|| [mean(seen.least), mean(seen.largest)])
        };
        seen.iter().map(mean).collect()
    }
}

#[cfg(test)]
mod tests {
    use burn_flex::{Flex, FlexDevice};

    use super::*;

    #[test]
    fn ranges_are_means_over_passes() {
        let observer = RangeObserver::new(2);
        for pass in [[-1.0, 3.0, 0.5], [-2.0, 1.0, 1.5]] {
            observer.record(1, &Tensor::<Flex, 1>::from_floats(pass, &FlexDevice));
        }
        assert_eq!(observer.ranges(), [None, Some([-1.5, 2.25])]);
    }
}
