//! Blocks of the motion GPT: attention across the three streams, perceptron, normalisation
//! (ARCHITECTURE section 3).

use bailando_kernels::{AttentionInputs, Convolution, Kernels, Kind, Queries};
use burn_tensor::{Bool, Int, Tensor, TensorData, activation::softmax, backend::Backend};

use super::parameters::{Parameters, Slot, Store};
use crate::weights::{Block, LayerNorm, Linear};

/// Music, upper and lower tokens lie one after the other.
pub(super) const STREAMS: usize = 3;

/// Which streams a stream's positions see, up to their own step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum View {
    /// All three (paper section 3.2, cross-conditional).
    All,
    /// Music and itself; music sees music alone, or it would connect the halves.
    OwnAndMusic,
}

impl View {
    fn forbids(self, seer: usize, seen: usize) -> bool {
        const MUSIC: usize = 0;
        self == Self::OwnAndMusic && seen != MUSIC && seen != seer
    }
}

/// True where attention is forbidden, `[3 * steps, 3 * steps]`: position `i` of any stream
/// sees positions up to `i` of the streams in its view.
fn causal_mask<B: Backend>(steps: usize, view: View, device: &B::Device) -> Tensor<B, 2, Bool> {
    let length = STREAMS * steps;
    let forbidden: Vec<bool> = (0..length * length)
        .map(|flat| {
            let (seer, seen) = (flat / length, flat % length);
            seen % steps > seer % steps || view.forbids(seer / steps, seen / steps)
        })
        .collect();
    Tensor::from_data(TensorData::new(forbidden, [length, length]), device)
}

/// Settings that all blocks of a pass share.
pub(super) struct Attention<B: Backend> {
    heads: usize,
    mask: Tensor<B, 2, Bool>,
    dropout: f64,
}

impl<B: Backend> Attention<B> {
    pub(super) fn new(
        heads: usize,
        steps: usize,
        view: View,
        dropout: f64,
        device: &B::Device,
    ) -> Self {
        Self { heads, mask: causal_mask(steps, view, device), dropout }
    }
}

/// Keys and values of the steps so far, `[batch, tokens, channels]` each.
#[derive(Clone, Debug)]
pub(super) struct KeysAndValues<B: Backend> {
    keys: Tensor<B, 3>,
    values: Tensor<B, 3>,
}

impl<B: Backend> KeysAndValues<B> {
    /// Appends the tokens of one more step.
    fn with(earlier: Option<Self>, keys: Tensor<B, 3>, values: Tensor<B, 3>) -> Self {
        match earlier {
            None => Self { keys, values },
            Some(earlier) => Self {
                keys: Tensor::cat(vec![earlier.keys, keys], 1),
                values: Tensor::cat(vec![earlier.values, values], 1),
            },
        }
    }

    /// Keeps some rows of the batch.
    pub(super) fn of(self, rows: Tensor<B, 1, Int>) -> Self {
        Self { keys: self.keys.select(0, rows.clone()), values: self.values.select(0, rows) }
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
        input: Tensor<B, 3>,
        context: &Attention<B>,
    ) -> Tensor<B, 3> {
        let normed = self.attention_norm.forward(parameters, input.clone());
        let attended = self.attend(parameters, normed, context);
        let hidden = input + dropout(attended, context.dropout);
        let normed = self.mlp_norm.forward(parameters, hidden.clone());
        let wide = B::activate(self.mlp_in.forward(parameters, normed));
        hidden + dropout(self.mlp_out.forward(parameters, wide), context.dropout)
    }

    /// [`BlockNet::forward`] for the tokens of the step after those in `cache`, without dropout. A
    /// token sees all tokens of the cache and of its own step.
    pub(super) fn extend<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Tensor<B, 3>,
        heads: usize,
        cache: &mut Option<KeysAndValues<B>>,
    ) -> Tensor<B, 3> {
        let normed = self.attention_norm.forward(parameters, input.clone());
        let part = |linear: &LinearNet| linear.forward(parameters, normed.clone());
        let (keys, values) = (part(&self.key), part(&self.value));
        let known = KeysAndValues::with(cache.take(), keys, values);
        let [batch, tokens, channels] = input.dims();
        let size = channels / heads;
        let split = |tensor: Tensor<B, 3>| {
            let [_, length, _] = tensor.dims();
            tensor.reshape([batch, length, heads, size]).swap_dims(1, 2)
        };
        let scale = 1.0 / (size as f64).sqrt();
        let query = split(part(&self.query)).mul_scalar(scale);
        let scores = query.matmul(split(known.keys.clone()).swap_dims(2, 3));
        let mixed = softmax(scores, 3).matmul(split(known.values.clone()));
        let mixed = mixed.swap_dims(1, 2).reshape([batch, tokens, channels]);
        *cache = Some(known);
        let hidden = input + self.projection.forward(parameters, mixed);
        let normed = self.mlp_norm.forward(parameters, hidden.clone());
        let wide = B::activate(self.mlp_in.forward(parameters, normed));
        hidden + self.mlp_out.forward(parameters, wide)
    }

    fn attend<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Tensor<B, 3>,
        context: &Attention<B>,
    ) -> Tensor<B, 3> {
        let part = |linear: &LinearNet| linear.forward(parameters, input.clone());
        let queries =
            Queries { query: part(&self.query), key: part(&self.key), value: part(&self.value) };
        let [batch, length, _] = input.dims();
        let kept = (context.dropout > 0.0).then(|| {
            let like = Tensor::empty([batch, context.heads, length, length], &input.device());
            B::kept(&like, context.dropout)
        });
        let (heads, forbidden) = (context.heads, context.mask.clone());
        let mixed = B::attend(AttentionInputs { heads, queries, forbidden, kept });
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
        Linear { weight: store.get(self.weight).transposed(), bias: store.get(self.bias).clone() }
    }

    pub(super) fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Tensor<B, 3>,
    ) -> Tensor<B, 3> {
        let plan = Convolution {
            kind: Kind::Pointwise,
            rectified: false,
            inputs: self.inputs,
            outputs: self.outputs,
        };
        parameters.observe(self.weight, &input);
        B::convolve(plan, parameters.affine(input, self.weight, self.bias))
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
        LayerNorm { weight: store.get(self.weight).clone(), bias: store.get(self.bias).clone() }
    }

    pub(super) fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        input: Tensor<B, 3>,
    ) -> Tensor<B, 3> {
        B::normalise(parameters.affine(input, self.weight, self.bias))
    }
}

/// Multiplies the last dimension by a matrix, as one product.
pub(super) fn multiplied<B: Backend>(input: Tensor<B, 3>, matrix: Tensor<B, 2>) -> Tensor<B, 3> {
    let [batch, length, channels] = input.dims();
    let [_, outputs] = matrix.dims();
    let rows = input.reshape([batch * length, channels]);
    rows.matmul(matrix).reshape([batch, length, outputs])
}

/// Sets a share of the values to zero and scales the others up.
pub(super) fn dropout<B: Kernels, const D: usize>(input: Tensor<B, D>, share: f64) -> Tensor<B, D> {
    if share <= 0.0 {
        return input;
    }
    let kept = B::kept(&input, share);
    input * kept
}

#[cfg(test)]
mod tests {
    use burn_flex::{Flex, FlexDevice};

    use super::*;

    /// The streams that the last step of each stream sees, and whether any step sees a later one.
    fn seen(view: View) -> ([Vec<usize>; STREAMS], bool) {
        const STEPS: usize = 4;
        let mask: Vec<bool> =
            causal_mask::<Flex>(STEPS, view, &FlexDevice).into_data().iter::<bool>().collect();
        let length = STREAMS * STEPS;
        let sees = |seer: usize, seen: usize| !mask[seer * length + seen];
        let streams = [0, 1, 2].map(|stream| {
            let seer = stream * STEPS + STEPS - 1;
            let all = (0..STREAMS).filter(|other| {
                let steps = (0..STEPS).filter(|step| sees(seer, other * STEPS + step));
                // All of its steps or none: the last step sees every step of what it sees.
                let count = steps.count();
                assert!(count == 0 || count == STEPS, "{stream} {other}: {count}");
                count > 0
            });
            all.collect()
        });
        let places = (0..length).flat_map(|seer| (0..length).map(move |seen| (seer, seen)));
        let mut later = places.filter(|&(seer, seen)| seen % STEPS > seer % STEPS);
        (streams, later.any(|(seer, seen)| sees(seer, seen)))
    }

    #[test]
    fn halves_see_each_other_unless_they_are_separate() {
        let every = || vec![0, 1, 2];
        assert_eq!(seen(View::All), ([every(), every(), every()], false));
        let separate = [vec![0], vec![0, 1], vec![0, 2]];
        assert_eq!(seen(View::OwnAndMusic), (separate, false));
    }
}
