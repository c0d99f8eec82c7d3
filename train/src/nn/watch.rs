//! What weights are multiplied with: post-training quantisation wants its range.

use std::sync::{Mutex, PoisonError};

use burn_tensor::{Tensor as Device, backend::Backend};

use super::parameters::values;

/// The least and the largest inputs of tensors, added up over passes.
///
/// Their means leave out what only some passes see: a number in a thousand times a thousand would cost all
/// others their precision.
#[derive(Debug)]
pub(super) struct Watch {
    seen: Mutex<Vec<Seen>>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    least: f64,
    largest: f64,
    passes: u32,
}

impl Watch {
    /// Of as many tensors, none of which has been used.
    pub(super) fn new(tensors: usize) -> Self {
        Self {
            seen: Mutex::new(vec![Seen::default(); tensors]),
        }
    }

    /// A tensor's next input.
    pub(super) fn see<B: Backend, const D: usize>(&self, tensor: usize, input: &Device<B, D>) {
        let input = values(input);
        let [least, largest] = input.iter().fold(
            [f32::INFINITY, f32::NEG_INFINITY],
            |[least, largest], &x| [least.min(x), largest.max(x)],
        );
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(seen) = seen.get_mut(tensor) {
            seen.least += f64::from(least);
            seen.largest += f64::from(largest);
            seen.passes += 1;
        }
    }

    /// Mean least and largest input of every tensor; none where it was not used.
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
        let watch = Watch::new(2);
        for pass in [[-1.0, 3.0, 0.5], [-2.0, 1.0, 1.5]] {
            watch.see(1, &Device::<Flex, 1>::from_floats(pass, &FlexDevice));
        }
        assert_eq!(watch.ranges(), [None, Some([-1.5, 2.25])]);
    }
}
