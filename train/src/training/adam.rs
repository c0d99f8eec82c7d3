//! Adam, with the length of the gradient limited over all tensors together.

use burn_tensor::{Tensor, backend::Backend};

use crate::nn::{Descent, Kernels};

const EPSILON: f64 = 1e-8;

/// Moments of every tensor, and how many steps have moved it.
#[derive(Clone, Debug)]
pub(super) struct Adam<B: Backend> {
    pub(super) first: Vec<Tensor<B, 1>>,
    pub(super) second: Vec<Tensor<B, 1>>,
    /// Steps of each tensor so far: a tensor without a gradient rests, and its moments with it.
    pub(super) updates: Vec<u32>,
    betas: [f64; 2],
}

impl<B: Kernels> Adam<B> {
    pub(super) fn new(tensors: &[Tensor<B, 1>], betas: [f64; 2]) -> Self {
        let zeros: Vec<_> = tensors.iter().map(Tensor::zeros_like).collect();
        Self { updates: vec![0; zeros.len()], first: zeros.clone(), second: zeros, betas }
    }

    /// Takes one step at each tensor's rate. A tensor without a gradient stays as it is.
    pub(super) fn step(
        &mut self,
        tensors: &mut [Tensor<B, 1>],
        gradients: Vec<Option<Tensor<B, 1>>>,
        rates: &[f64],
    ) {
        let moments = self.first.iter_mut().zip(&mut self.second).zip(&mut self.updates);
        let tensors = tensors.iter_mut().zip(rates).zip(gradients);
        for (((tensor, &rate), gradient), ((first, second), updates)) in tensors.zip(moments) {
            let Some(gradient) = gradient else { continue };
            *updates = updates.saturating_add(1);
            let step = Descent {
                betas: self.betas,
                corrections: self
                    .betas
                    .map(|beta| 1.0 - beta.powi(i32::try_from(*updates).unwrap_or(i32::MAX))),
                rate,
                epsilon: EPSILON,
            };
            let empty = || Tensor::empty([0], &gradient.device());
            // Taken out, so that the kernel may change them in place.
            let taken = [&mut *tensor, &mut *first, &mut *second]
                .map(|slot| std::mem::replace(slot, empty()));
            let [value, one, two] = taken;
            let (value, [one, two]) = B::descend(step, value, gradient, [one, two]);
            (*tensor, *first, *second) = (value, one, two);
        }
    }
}

/// Scales all gradients by one factor so that together they are at most `longest` long; 0 leaves
/// them alone.
pub(super) fn clip<B: Backend>(gradients: &mut [Option<Tensor<B, 1>>], longest: f64) {
    if longest <= 0.0 {
        return;
    }
    let squares = gradients.iter().flatten().map(|gradient| gradient.clone().square().sum());
    let Some(square) = squares.reduce(|sum, square| sum + square) else {
        return;
    };
    // Never read back: a read would make the host wait for the device at every step.
    let factor = (square.sqrt().add_scalar(1e-12)).recip().mul_scalar(longest).clamp_max(1.0);
    for gradient in gradients.iter_mut().flatten() {
        *gradient = gradient.clone() * factor.clone();
    }
}

#[cfg(test)]
mod tests {
    use burn_flex::Flex;

    use super::*;

    fn tensor(values: [f32; 2]) -> Tensor<Flex, 1> {
        Tensor::from_floats(values, &Default::default())
    }

    fn values(tensor: &Tensor<Flex, 1>) -> Vec<f32> {
        tensor.to_data().iter::<f32>().collect()
    }

    #[test]
    fn steps_follow_the_definition() {
        let mut tensors = [tensor([1.0, -2.0])];
        let mut adam = Adam::new(&tensors, [0.9, 0.99]);
        let (mut weight, mut first, mut second) = (1.0_f64, 0.0_f64, 0.0_f64);
        for (step, gradient) in [0.5, -0.1, 3.0].into_iter().enumerate() {
            let gradients = vec![Some(tensor([gradient as f32, 0.0]))];
            adam.step(&mut tensors, gradients, &[0.01]);
            first = 0.9 * first + 0.1 * gradient;
            second = 0.99 * second + 0.01 * gradient * gradient;
            let count = step as i32 + 1;
            let (m, v) =
                (first / (1.0 - 0.9_f64.powi(count)), second / (1.0 - 0.99_f64.powi(count)));
            weight -= 0.01 * m / (v.sqrt() + 1e-8);
        }
        let found = values(&tensors[0]);
        assert!((f64::from(found[0]) - weight).abs() < 1e-6, "{found:?} {weight}");
        assert_eq!(found[1], -2.0);
    }

    #[test]
    fn every_tensor_counts_its_own_steps() {
        let mut tensors = [tensor([1.0, 1.0]), tensor([1.0, 1.0])];
        let mut adam = Adam::new(&tensors, [0.9, 0.99]);
        let gradient = || Some(tensor([0.5, -0.5]));
        adam.step(&mut tensors, vec![None, gradient()], &[0.01; 2]);
        adam.step(&mut tensors, vec![gradient(), gradient()], &[0.01; 2]);
        assert_eq!(adam.updates, [1, 2]);
        // Of constant gradients every step is one rate long, if it is corrected for its own count.
        let moved = tensors.map(|tensor| 1.0 - values(&tensor)[0]);
        assert!((moved[0] - 0.01).abs() < 1e-6 && (moved[1] - 0.02).abs() < 1e-6, "{moved:?}");
    }

    #[test]
    fn clipping_keeps_the_direction() {
        let mut gradients = [Some(tensor([3.0, 0.0])), None, Some(tensor([0.0, 4.0]))];
        clip(&mut gradients, 10.0);
        assert_eq!(values(gradients[0].as_ref().unwrap()), [3.0, 0.0]);
        clip(&mut gradients, 1.0);
        let found = values(gradients[2].as_ref().unwrap());
        assert!((found[1] - 0.8).abs() < 1e-6);
    }
}
