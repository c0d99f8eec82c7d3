//! The motion GPT (ARCHITECTURE section 3): state network and policy.

use burn_tensor::{
    Bool, Distribution, Int, Tensor as Device, TensorData,
    activation::{gelu, softmax},
    backend::Backend,
};

use super::parameters::{Parameters, Slot, Store};
use crate::{
    Tensor,
    weights::{Block, GptWeights, LayerNorm, Linear},
};

/// Music, upper and lower tokens lie behind one another.
const STREAMS: usize = 3;
const NORM_EPSILON: f64 = 1e-5;

/// Scores of the next codes, `[batch, steps, vocabulary]` each.
#[derive(Clone, Debug)]
pub struct Logits<B: Backend> {
    /// Upper half.
    pub upper: Device<B, 3>,
    /// Lower half.
    pub lower: Device<B, 3>,
}

/// The network's plan.
#[derive(Clone, Debug)]
pub struct GptNet {
    music: LinearNet,
    upper_embedding: Slot,
    lower_embedding: Slot,
    positions: Slot,
    blocks: Vec<BlockNet>,
    final_norm: NormNet,
    upper_head: Slot,
    lower_head: Slot,
    heads: usize,
    block: usize,
}

impl GptNet {
    /// Plans the network and appends its weights to `store`.
    #[must_use]
    pub fn new(weights: &GptWeights, store: &mut Store) -> Self {
        let matrix =
            |name: &str, tensor: Tensor, store: &mut Store| store.push(name.into(), tensor);
        let blocks = weights.blocks.iter().enumerate();
        Self {
            music: LinearNet::new("music", &weights.music, store),
            upper_embedding: matrix("upper_embedding", weights.upper_embedding.clone(), store),
            lower_embedding: matrix("lower_embedding", weights.lower_embedding.clone(), store),
            positions: matrix("positions", weights.positions.clone(), store),
            blocks: blocks
                .map(|(index, block)| BlockNet::new(&format!("blocks.{index}"), block, store))
                .collect(),
            final_norm: NormNet::new("final_norm", &weights.final_norm, store),
            upper_head: matrix("upper_head", weights.upper_head.transposed(), store),
            lower_head: matrix("lower_head", weights.lower_head.transposed(), store),
            heads: weights.heads,
            block: weights.block(),
        }
    }

    /// The weights as they are in `store`.
    #[must_use]
    pub fn weights(&self, store: &Store) -> GptWeights {
        GptWeights {
            music: self.music.weights(store),
            upper_embedding: store.get(self.upper_embedding).clone(),
            lower_embedding: store.get(self.lower_embedding).clone(),
            positions: store.get(self.positions).clone(),
            blocks: self
                .blocks
                .iter()
                .map(|block| block.weights(store))
                .collect(),
            final_norm: self.final_norm.weights(store),
            upper_head: store.get(self.upper_head).transposed(),
            lower_head: store.get(self.lower_head).transposed(),
            heads: self.heads,
        }
    }

    /// Longest history, in steps.
    #[must_use]
    pub fn block(&self) -> usize {
        self.block
    }

    /// Scores of the next codes after each of at most `block` steps. Music is `[batch, steps,
    /// columns]`, codes `[batch, steps]`; `dropout` is the share of activations set to zero.
    pub fn forward<B: Backend>(
        &self,
        parameters: &Parameters<B>,
        music: Device<B, 3>,
        codes: [Device<B, 2, Int>; 2],
        dropout: f64,
    ) -> Logits<B> {
        let [batch, steps, _] = music.dims();
        let music = self.music.forward(parameters, music);
        let [upper, lower] = codes;
        let embedded = |slot, codes: Device<B, 2, Int>| {
            let rows = parameters
                .matrix(slot)
                .select(0, codes.reshape([batch * steps]));
            let [_, channels] = rows.dims();
            rows.reshape([batch, steps, channels])
        };
        let upper = embedded(self.upper_embedding, upper);
        let lower = embedded(self.lower_embedding, lower);
        let tokens =
            Device::cat(vec![music, upper, lower], 1) + self.position_rows(parameters, steps);
        let mask = cross_conditional_mask(steps, parameters.device());
        let context = Attention {
            heads: self.heads,
            mask,
            dropout,
        };
        let hidden = self
            .blocks
            .iter()
            .fold(drop(tokens, dropout), |hidden, block| {
                block.forward(parameters, hidden, &context)
            });
        let hidden = self.final_norm.forward(parameters, hidden);
        let scores = |slot, stream: usize| {
            let rows = hidden.clone().narrow(1, stream * steps, steps);
            multiplied(rows, parameters.matrix(slot))
        };
        Logits {
            upper: scores(self.upper_head, 1),
            lower: scores(self.lower_head, 2),
        }
    }

    /// The first `steps` positions of each stream, `[1, 3 * steps, channels]`.
    fn position_rows<B: Backend>(&self, parameters: &Parameters<B>, steps: usize) -> Device<B, 3> {
        let table = parameters.matrix(self.positions);
        let parts = (0..STREAMS).map(|stream| table.clone().narrow(0, stream * self.block, steps));
        Device::cat(parts.collect(), 0).unsqueeze_dim(0)
    }
}

/// True where attention is forbidden, `[1, 1, 3 * steps, 3 * steps]`: position `i` of any stream
/// sees positions up to `i` of all three.
fn cross_conditional_mask<B: Backend>(steps: usize, device: &B::Device) -> Device<B, 4, Bool> {
    let length = STREAMS * steps;
    let forbidden: Vec<bool> = (0..length * length)
        .map(|flat| (flat % length) % steps > (flat / length) % steps)
        .collect();
    Device::from_data(TensorData::new(forbidden, [1, 1, length, length]), device)
}

struct Attention<B: Backend> {
    heads: usize,
    mask: Device<B, 4, Bool>,
    dropout: f64,
}

#[derive(Clone, Debug)]
struct BlockNet {
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
    fn new(name: &str, weights: &Block, store: &mut Store) -> Self {
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

    fn weights(&self, store: &Store) -> Block {
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

    fn forward<B: Backend>(
        &self,
        parameters: &Parameters<B>,
        input: Device<B, 3>,
        context: &Attention<B>,
    ) -> Device<B, 3> {
        let normed = self.attention_norm.forward(parameters, input.clone());
        let attended = self.attend(parameters, normed, context);
        let hidden = input + drop(attended, context.dropout);
        let normed = self.mlp_norm.forward(parameters, hidden.clone());
        let wide = gelu(self.mlp_in.forward(parameters, normed));
        hidden + drop(self.mlp_out.forward(parameters, wide), context.dropout)
    }

    fn attend<B: Backend>(
        &self,
        parameters: &Parameters<B>,
        input: Device<B, 3>,
        context: &Attention<B>,
    ) -> Device<B, 3> {
        let [batch, length, channels] = input.dims();
        let heads = context.heads;
        let size = channels / heads;
        let split = |linear: &LinearNet| {
            let all = linear.forward(parameters, input.clone());
            all.reshape([batch, length, heads, size]).swap_dims(1, 2)
        };
        let query = split(&self.query).mul_scalar(1.0 / (size as f64).sqrt());
        let scores = query.matmul(split(&self.key).swap_dims(2, 3));
        let mask = context.mask.clone().expand([batch, heads, length, length]);
        let shares = softmax(scores.mask_fill(mask, f32::NEG_INFINITY), 3);
        let mixed = drop(shares, context.dropout).matmul(split(&self.value));
        let joined = mixed.swap_dims(1, 2).reshape([batch, length, channels]);
        self.projection.forward(parameters, joined)
    }
}

#[derive(Clone, Debug)]
struct LinearNet {
    /// `[in, out]`.
    weight: Slot,
    bias: Slot,
}

impl LinearNet {
    fn new(name: &str, weights: &Linear, store: &mut Store) -> Self {
        Self {
            weight: store.push(format!("{name}.weight"), weights.weight.transposed()),
            bias: store.push(format!("{name}.bias"), weights.bias.clone()),
        }
    }

    fn weights(&self, store: &Store) -> Linear {
        Linear {
            weight: store.get(self.weight).transposed(),
            bias: store.get(self.bias).clone(),
        }
    }

    fn forward<B: Backend>(&self, parameters: &Parameters<B>, input: Device<B, 3>) -> Device<B, 3> {
        let product = multiplied(input, parameters.matrix(self.weight));
        product + parameters.row(self.bias).unsqueeze_dim(0)
    }
}

#[derive(Clone, Debug)]
struct NormNet {
    weight: Slot,
    bias: Slot,
}

impl NormNet {
    fn new(name: &str, weights: &LayerNorm, store: &mut Store) -> Self {
        Self {
            weight: store.push(format!("{name}.weight"), weights.weight.clone()),
            bias: store.push(format!("{name}.bias"), weights.bias.clone()),
        }
    }

    fn weights(&self, store: &Store) -> LayerNorm {
        LayerNorm {
            weight: store.get(self.weight).clone(),
            bias: store.get(self.bias).clone(),
        }
    }

    fn forward<B: Backend>(&self, parameters: &Parameters<B>, input: Device<B, 3>) -> Device<B, 3> {
        let mean = input.clone().mean_dim(2);
        let centred = input - mean;
        let variance = centred.clone().square().mean_dim(2);
        let scaled = centred / variance.add_scalar(NORM_EPSILON).sqrt();
        let row = |slot| parameters.row(slot).unsqueeze_dim(0);
        scaled * row(self.weight) + row(self.bias)
    }
}

/// The last dimension times a matrix, as one product.
fn multiplied<B: Backend>(input: Device<B, 3>, matrix: Device<B, 2>) -> Device<B, 3> {
    let [batch, length, channels] = input.dims();
    let [_, outputs] = matrix.dims();
    let rows = input.reshape([batch * length, channels]);
    rows.matmul(matrix).reshape([batch, length, outputs])
}

/// Sets a share of the values to zero and scales the others up.
fn drop<B: Backend, const D: usize>(input: Device<B, D>, share: f64) -> Device<B, D> {
    if share <= 0.0 {
        return input;
    }
    let keep = input.random_like(Distribution::Bernoulli(1.0 - share));
    input * keep.mul_scalar(1.0 / (1.0 - share))
}
