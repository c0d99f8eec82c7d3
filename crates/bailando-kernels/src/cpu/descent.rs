//! Adam in one pass over a tensor and its moments.

use burn_flex::{Flex, FlexTensor};
use burn_tensor::{Tensor, TensorPrimitive};
use rayon::prelude::*;

use super::memory::{host, values};
use crate::Descent;

/// Values that one thread takes at a time.
const PART: usize = 16_384;

pub(super) fn descend(
    step: Descent,
    tensor: Tensor<Flex, 1>,
    gradient: Tensor<Flex, 1>,
    [first, second]: [Tensor<Flex, 1>; 2],
) -> (Tensor<Flex, 1>, [Tensor<Flex, 1>; 2]) {
    let gradient = host(gradient);
    let [mut tensor, mut first, mut second] = [tensor, first, second].map(host);
    let [beta1, beta2] = step.betas.map(|beta| beta as f32);
    let [fresh1, fresh2] = step.betas.map(|beta| (1.0 - beta) as f32);
    let [correction1, correction2] = step.corrections;
    let (rate, correction2) = ((step.rate / correction1) as f32, correction2 as f32);
    let epsilon = step.epsilon as f32;
    tensor
        .storage_mut::<f32>()
        .par_chunks_mut(PART)
        .zip(first.storage_mut::<f32>().par_chunks_mut(PART))
        .zip(second.storage_mut::<f32>().par_chunks_mut(PART))
        .zip(values(&gradient).par_chunks(PART))
        .for_each(|(((tensor, first), second), gradient)| {
            let moments = first.iter_mut().zip(second);
            for ((value, gradient), (first, second)) in tensor.iter_mut().zip(gradient).zip(moments)
            {
                *first = *first * beta1 + gradient * fresh1;
                *second = *second * beta2 + gradient * gradient * fresh2;
                *value -= *first * rate / ((*second / correction2).sqrt() + epsilon);
            }
        });
    let wrap = |tensor: FlexTensor| Tensor::from_primitive(TensorPrimitive::Float(tensor));
    (wrap(tensor), [wrap(first), wrap(second)])
}
