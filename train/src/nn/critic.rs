//! The critic (ARCHITECTURE section 3, paper `f_v`): the reward still to come in a state.

use bailando_kernels::Kernels;
use burn_tensor::Tensor;

use super::{
    parameters::{Parameters, Slot, Store},
    transformer::{Attention, BlockNet, NormNet, STREAMS, View, multiplied},
};
use crate::weights::CriticWeights;

/// The network's plan; its input is the output of [`super::GptNet::states`].
#[derive(Clone, Debug)]
pub struct CriticNet {
    blocks: Vec<BlockNet>,
    final_norm: NormNet,
    upper_value: Slot,
    lower_value: Slot,
    heads: usize,
}

impl CriticNet {
    /// Plans the network and appends its weights to `store`.
    #[must_use]
    pub fn new(weights: &CriticWeights, store: &mut Store) -> Self {
        let blocks = weights.blocks.iter().enumerate();
        let blocks = blocks
            .map(|(index, block)| BlockNet::new(&format!("critic.blocks.{index}"), block, store));
        let blocks = blocks.collect();
        let final_norm = NormNet::new("critic.final_norm", &weights.final_norm, store);
        let mut map = |name: &str, weights: &crate::HostTensor| {
            store.push(format!("critic.{name}"), weights.transposed())
        };
        Self {
            blocks,
            final_norm,
            upper_value: map("upper_value", &weights.upper_value),
            lower_value: map("lower_value", &weights.lower_value),
            heads: weights.heads,
        }
    }

    /// The weights as they are in `store`.
    #[must_use]
    pub fn weights(&self, store: &Store) -> CriticWeights {
        let blocks = self.blocks.iter();
        CriticWeights {
            blocks: blocks.map(|block| block.weights(store)).collect(),
            final_norm: self.final_norm.weights(store),
            upper_value: store.get(self.upper_value).transposed(),
            lower_value: store.get(self.lower_value).transposed(),
            heads: self.heads,
        }
    }

    /// Computes the values of `[batch, 3 * steps, channels]` states, upper + lower: `[batch,
    /// steps]`.
    pub fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        states: Tensor<B, 3>,
    ) -> Tensor<B, 2> {
        let [batch, tokens, _] = states.dims();
        let steps = tokens / STREAMS;
        // The critic sees the whole body, also where the halves of the policy do not see each
        // other.
        let context = Attention::new(self.heads, steps, View::All, 0.0, parameters.device());
        let blocks = self.blocks.iter();
        let hidden =
            blocks.fold(states, |hidden, block| block.forward(parameters, hidden, &context));
        let hidden = self.final_norm.forward(parameters, hidden);
        let value = |slot, stream: usize| {
            let rows = hidden.clone().narrow(1, stream * steps, steps);
            multiplied(rows, parameters.matrix(slot))
        };
        let value = value(self.upper_value, 1) + value(self.lower_value, 2);
        value.reshape([batch, steps])
    }
}
