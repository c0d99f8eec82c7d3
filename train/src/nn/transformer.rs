//! Blocks of the motion GPT: attention across the three streams, perceptron, normalisation
//! (ARCHITECTURE section 3).

use burn_tensor::{Bool, Tensor as Device, TensorData, backend::Backend};

use super::{
    kernels::{Convolution, Heads, Kernels, Kind, Queries},
    parameters::{Parameters, Slot, Store},
};
use crate::weights::{Block, LayerNorm, Linear};

/// Music, upper and lower tokens lie behind one another.
pub(super) const STREAMS: usize = 3;

/// True where attention is forbidden, `[3 * steps, 3 * steps]`: position `i` of any stream
/// sees positions up to `i` of all three.
fn cross_conditional_mask<B: Backend>(steps: usize, device: &B::Device) -> Device<B, 2, Bool> {
    let length = STREAMS * steps;
    let forbidden: Vec<bool> = (0..length * length)
        .map(|flat| (flat % length) % steps > (flat / length) % steps)
        .collect();
    Device::from_data(TensorData::new(forbidden, [length, length]), device)
}

/// What all blocks of a pass share.
pub(super) struct Attention<B: Backend> {
    heads: usize,
    mask: Device<B, 2, Bool>,
    dropout: f64,
}

impl<B: Backend> Attention<B> {
    pub(super) fn new(heads: usize, steps: usize, dropout: f64, device: &B::Device) -> Self {
        Self {
            heads,
            mask: cross_conditional_mask(steps, device),
            dropout,
        }
    }
}

#[derive(Clone, Debug)]
pub(super) struct BlockNet {
    attention_norm: NormNet,
    query: LinearNet,
    key: LinearNet,
    value: LinearNet,
    projection: LinearNet,
    mlp_norm: NormNet,
    mlp_in: LinearNet,
    mlp_out: LinearNet,
}

impl BlockNet {
    pub(super) fn new(name: &str, weights: &Block, store: &mut Store) -> Self {
        let mut linear =
            |part: &str, weights| LinearNet::new(&format!("{name}.{part}"), weights, store);
        let query = linear("query", &weights.query);
        let key = linear("key", &weights.key);
        let value = linear("value", &weights.value);
        let projection = linear("projection", &weights.projection);
        let mlp_in = linear("mlp_in", &weights.mlp_in);
        let mlp_out = linear("mlp_out", &weights.mlp_out);
        let mut norm =
            |part: &str, weights| NormNet::new(&format!("{name}.{part}"), weights, store);
        Self {
            attention_norm: norm("attention_norm", &weights.attention_norm),
            mlp_norm: norm("mlp_norm", &weights.mlp_norm),
            query,
            key,
            value,
            projection,
            mlp_in,
            mlp_out,
        }
    }

    pub(super) fn weights(&self, store: &Store) -> Block {
        Block {
            attention_norm: self.attention_norm.weights(store),
            query: self.query.weights(store),
            key: self.key.weights(store),
            value: self.value.weights(store),
            projection: self.projection.weights(store),
            mlp_norm: self.mlp_norm.weights(store),
            mlp_in: self.mlp_in.weights(store),
            mlp_out: self.mlp_out.weights(store),
        }
    }

    pub(super) fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Device<B, 3>,
        context: &Attention<B>,
    ) -> Device<B, 3> {
        let normed = self.attention_norm.forward(parameters, input.clone());
        let attended = self.attend(parameters, normed, context);
        let hidden = input + drop(attended, context.dropout);
        let normed = self.mlp_norm.forward(parameters, hidden.clone());
        let wide = B::activate(self.mlp_in.forward(parameters, normed));
        hidden + drop(self.mlp_out.forward(parameters, wide), context.dropout)
    }

    fn attend<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Device<B, 3>,
        context: &Attention<B>,
    ) -> Device<B, 3> {
        let part = |linear: &LinearNet| linear.forward(parameters, input.clone());
        let queries = Queries {
            query: part(&self.query),
            key: part(&self.key),
            value: part(&self.value),
        };
        let [batch, length, _] = input.dims();
        let kept = (context.dropout > 0.0).then(|| {
            let like = Device::empty([batch, context.heads, length, length], &input.device());
            B::kept(&like, context.dropout)
        });
        let heads = Heads {
            count: context.heads,
        };
        let mixed = B::attend(heads, queries, context.mask.clone(), kept);
        self.projection.forward(parameters, mixed)
    }
}

#[derive(Clone, Debug)]
pub(super) struct LinearNet {
    /// `[in, out]`.
    weight: Slot,
    bias: Slot,
    inputs: usize,
    outputs: usize,
}

impl LinearNet {
    pub(super) fn new(name: &str, weights: &Linear, store: &mut Store) -> Self {
        Self {
            weight: store.push(format!("{name}.weight"), weights.weight.transposed()),
            bias: store.push(format!("{name}.bias"), weights.bias.clone()),
            inputs: weights.weight.dim(1),
            outputs: weights.weight.dim(0),
        }
    }

    pub(super) fn weights(&self, store: &Store) -> Linear {
        Linear {
            weight: store.get(self.weight).transposed(),
            bias: store.get(self.bias).clone(),
        }
    }

    pub(super) fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Device<B, 3>,
    ) -> Device<B, 3> {
        let plan = Convolution {
            kind: Kind::Pointwise,
            rectified: false,
            inputs: self.inputs,
            outputs: self.outputs,
        };
        let (weight, bias) = (parameters.flat(self.weight), parameters.flat(self.bias));
        B::convolve(plan, input, weight, bias)
    }
}

#[derive(Clone, Debug)]
pub(super) struct NormNet {
    weight: Slot,
    bias: Slot,
}

impl NormNet {
    pub(super) fn new(name: &str, weights: &LayerNorm, store: &mut Store) -> Self {
        Self {
            weight: store.push(format!("{name}.weight"), weights.weight.clone()),
            bias: store.push(format!("{name}.bias"), weights.bias.clone()),
        }
    }

    pub(super) fn weights(&self, store: &Store) -> LayerNorm {
        LayerNorm {
            weight: store.get(self.weight).clone(),
            bias: store.get(self.bias).clone(),
        }
    }

    pub(super) fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Device<B, 3>,
    ) -> Device<B, 3> {
        let (weight, bias) = (parameters.flat(self.weight), parameters.flat(self.bias));
        B::normalise(input, weight, bias)
    }
}

/// The last dimension times a matrix, as one product.
pub(super) fn multiplied<B: Backend>(input: Device<B, 3>, matrix: Device<B, 2>) -> Device<B, 3> {
    let [batch, length, channels] = input.dims();
    let [_, outputs] = matrix.dims();
    let rows = input.reshape([batch * length, channels]);
    rows.matmul(matrix).reshape([batch, length, outputs])
}

/// Sets a share of the values to zero and scales the others up.
pub(super) fn drop<B: Kernels, const D: usize>(input: Device<B, D>, share: f64) -> Device<B, D> {
    if share <= 0.0 {
        return input;
    }
    let kept = B::kept(&input, share);
    input * kept
}
