//! The motion GPT (ARCHITECTURE section 3): state network and policy.

use bailando_kernels::Kernels;
use burn_tensor::{Int, Tensor, backend::Backend};

use super::{
    parameters::{Parameters, Slot, Store},
    transformer::{
        self, Attention, BlockNet, KeysAndValues, LinearNet, NormNet, STREAMS, View, multiplied,
    },
};
use crate::{HostTensor, weights::GptWeights};

/// Scores of the next codes, `[batch, steps, vocabulary]` each.
#[derive(Clone, Debug)]
pub struct Logits<B: Backend> {
    /// Upper half.
    pub upper: Tensor<B, 3>,
    /// Lower half.
    pub lower: Tensor<B, 3>,
}

impl<B: Backend> Logits<B> {
    /// Returns the scores of codes that are drawn at a temperature above 0.
    #[must_use]
    pub fn at_temperature(self, temperature: f64) -> Self {
        let scaled = |scores: Tensor<B, 3>| scores.div_scalar(temperature);
        Self { upper: scaled(self.upper), lower: scaled(self.lower) }
    }
}

/// Keys and values of pieces that the network extends step by step.
#[derive(Clone, Debug)]
pub struct KvCache<B: Backend> {
    blocks: Vec<Option<KeysAndValues<B>>>,
    steps: usize,
}

impl<B: Backend> KvCache<B> {
    /// Keeps some of the pieces.
    #[must_use]
    pub fn of(self, pieces: &Tensor<B, 1, Int>) -> Self {
        let blocks = self.blocks.into_iter();
        Self {
            blocks: blocks.map(|block| block.map(|known| known.of(pieces.clone()))).collect(),
            ..self
        }
    }
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
    view: View,
    one_code: bool,
}

impl GptNet {
    /// Plans the network and appends its weights to `store`.
    #[must_use]
    pub fn new(weights: &GptWeights, store: &mut Store) -> Self {
        let matrix =
            |name: &str, tensor: HostTensor, store: &mut Store| store.push(name.into(), tensor);
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
            view: View::All,
            one_code: false,
        }
    }

    /// Removes attention from one half of the body to the other: two networks that share weights.
    #[must_use]
    pub fn with_separate_halves(self) -> Self {
        Self { view: View::OwnAndMusic, ..self }
    }

    /// Changes the network to codes of the whole body: both streams carry the same ones, and only
    /// the upper head scores the next.
    #[must_use]
    pub fn with_one_code(self) -> Self {
        Self { one_code: true, ..self }
    }

    /// Whether both streams carry the same codes.
    #[must_use]
    pub fn has_one_code(&self) -> bool {
        self.one_code
    }

    /// Returns the weights in `store`.
    #[must_use]
    pub fn weights(&self, store: &Store) -> GptWeights {
        GptWeights {
            music: self.music.weights(store),
            upper_embedding: store.get(self.upper_embedding).clone(),
            lower_embedding: store.get(self.lower_embedding).clone(),
            positions: store.get(self.positions).clone(),
            blocks: self.blocks.iter().map(|block| block.weights(store)).collect(),
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

    /// Computes the scores of the next codes after each of at most `block` steps. Music is `[batch,
    /// steps, columns]`, codes `[batch, steps]`; `dropout` is the share of activations set to zero.
    pub fn forward<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        music: Tensor<B, 3>,
        codes: [Tensor<B, 2, Int>; 2],
        dropout: f64,
    ) -> Logits<B> {
        let layers = self.blocks.len();
        let states = self.states(parameters, music, codes, layers, dropout);
        self.policy(parameters, states, layers, dropout)
    }

    /// Returns an empty cache; `None` where a step does not see all streams of the steps before it.
    #[must_use]
    pub fn empty_cache<B: Backend>(&self) -> Option<KvCache<B>> {
        (self.view == View::All)
            .then(|| KvCache { blocks: vec![None; self.blocks.len()], steps: 0 })
    }

    /// Computes the scores after one step more than the cache holds, at most `block` in all, as
    /// [`GptNet::forward`] does for its last step. Music is `[batch, 1, columns]`, codes `[batch,
    /// 1]`.
    pub fn extend<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        cache: &mut KvCache<B>,
        music: Tensor<B, 3>,
        codes: [Tensor<B, 2, Int>; 2],
    ) -> Logits<B> {
        let embedded = self.embedded(parameters, codes);
        let tokens = self.tokens(parameters, music, embedded, cache.steps);
        let blocks = self.blocks.iter().zip(&mut cache.blocks);
        let hidden = blocks.fold(tokens, |hidden, (block, known)| {
            block.extend(parameters, hidden, self.heads, known)
        });
        cache.steps += 1;
        self.scores(parameters, hidden)
    }

    /// Runs the network on vectors `[batch, steps, n]` in place of codes, with a vocabulary of `n`:
    /// their columns weigh the rows of the embedding tables, and the scores are the next vectors.
    pub fn regress<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        music: Tensor<B, 3>,
        [upper, lower]: [Tensor<B, 3>; 2],
        dropout: f64,
    ) -> Logits<B> {
        let upper = multiplied(upper, parameters.matrix(self.upper_embedding));
        let lower = multiplied(lower, parameters.matrix(self.lower_embedding));
        let layers = self.blocks.len();
        let states = self.embedded_states(parameters, music, [upper, lower], layers, dropout);
        self.policy(parameters, states, layers, dropout)
    }

    /// Computes the states of music and codes, `[batch, 3 * steps, channels]`: the state network is
    /// the first `layers` blocks.
    pub fn states<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        music: Tensor<B, 3>,
        codes: [Tensor<B, 2, Int>; 2],
        layers: usize,
        dropout: f64,
    ) -> Tensor<B, 3> {
        let embedded = self.embedded(parameters, codes);
        self.embedded_states(parameters, music, embedded, layers, dropout)
    }

    /// Looks up the codes in their tables.
    fn embedded<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        [upper, lower]: [Tensor<B, 2, Int>; 2],
    ) -> [Tensor<B, 3>; 2] {
        let rows = |slot, codes: Tensor<B, 2, Int>| {
            let [batch, steps] = codes.dims();
            let rows = parameters.matrix(slot).select(0, codes.reshape([batch * steps]));
            let [_, channels] = rows.dims();
            rows.reshape([batch, steps, channels])
        };
        [rows(self.upper_embedding, upper), rows(self.lower_embedding, lower)]
    }

    fn embedded_states<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        music: Tensor<B, 3>,
        embedded: [Tensor<B, 3>; 2],
        layers: usize,
        dropout: f64,
    ) -> Tensor<B, 3> {
        let [_, steps, _] = music.dims();
        let tokens = self.tokens(parameters, music, embedded, 0);
        let context = self.attention(steps, dropout, parameters);
        let blocks = self.blocks.iter().take(layers);
        blocks.fold(transformer::dropout(tokens, dropout), |hidden, block| {
            block.forward(parameters, hidden, &context)
        })
    }

    /// Embeds all streams of steps whose first has the position `first`, `[batch, 3 * steps,
    /// channels]`.
    fn tokens<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        music: Tensor<B, 3>,
        [upper, lower]: [Tensor<B, 3>; 2],
        first: usize,
    ) -> Tensor<B, 3> {
        let [_, steps, _] = music.dims();
        let music = self.music.forward(parameters, music);
        let table = parameters.matrix(self.positions);
        let places =
            (0..STREAMS).map(|stream| table.clone().narrow(0, stream * self.block + first, steps));
        let places = Tensor::cat(places.collect(), 0).unsqueeze_dim(0);
        Tensor::cat(vec![music, upper, lower], 1) + places
    }

    /// Computes the scores of such states: the policy is the blocks from `layers` on.
    pub fn policy<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        states: Tensor<B, 3>,
        layers: usize,
        dropout: f64,
    ) -> Logits<B> {
        let [_, tokens, _] = states.dims();
        let steps = tokens / STREAMS;
        let context = self.attention(steps, dropout, parameters);
        let blocks = self.blocks.iter().skip(layers);
        let hidden =
            blocks.fold(states, |hidden, block| block.forward(parameters, hidden, &context));
        self.scores(parameters, hidden)
    }

    fn scores<B: Kernels>(&self, parameters: &Parameters<B>, hidden: Tensor<B, 3>) -> Logits<B> {
        let [_, tokens, _] = hidden.dims();
        let steps = tokens / STREAMS;
        let hidden = self.final_norm.forward(parameters, hidden);
        let scores = |slot, stream: usize| {
            let rows = hidden.clone().narrow(1, stream * steps, steps);
            parameters.observe(slot, &rows);
            multiplied(rows, parameters.matrix(slot))
        };
        let upper = scores(self.upper_head, 1);
        let lower = match self.one_code {
            true => upper.clone(),
            false => scores(self.lower_head, 2),
        };
        Logits { upper, lower }
    }

    fn attention<B: Kernels>(
        &self,
        steps: usize,
        dropout: f64,
        parameters: &Parameters<B>,
    ) -> Attention<B> {
        Attention::new(self.heads, steps, self.view, dropout, parameters.device())
    }
}

#[cfg(test)]
mod tests {
    use burn_flex::{Flex, FlexDevice};
    use burn_tensor::TensorData;

    use super::*;
    use crate::nn::{GptSizes, random_gpt, values};

    const STEPS: usize = 5;

    /// Upper and lower scores for music, upper and lower codes that are all of one number.
    fn scores(net: impl Fn(GptNet) -> GptNet, [music, upper, lower]: [i32; 3]) -> [Vec<f32>; 2] {
        let sizes =
            GptSizes { channels: 8, heads: 2, layers: 3, block: STEPS, codes: [6, 6], columns: 4 };
        let mut store = Store::default();
        let net = net(GptNet::new(&random_gpt(sizes, 7), &mut store));
        let parameters = Parameters::<Flex>::from_store(&store, &FlexDevice);
        let rows = Tensor::full([1, STEPS, 4], music as f32, &FlexDevice);
        let codes = [upper, lower].map(|code| {
            let codes = TensorData::new(vec![code; STEPS], [1, STEPS]);
            Tensor::from_data(codes, &FlexDevice)
        });
        let logits = net.forward(&parameters, rows, codes, 0.0);
        [values(&logits.upper), values(&logits.lower)]
    }

    #[test]
    fn separate_halves_see_the_music_but_not_each_other() {
        for separate in [false, true] {
            let form = |net: GptNet| match separate {
                true => net.with_separate_halves(),
                false => net,
            };
            let [upper, lower] = scores(form, [1, 2, 3]);
            let [with_other_lower, own] = scores(form, [1, 2, 4]);
            assert_ne!(own, lower);
            assert_eq!(with_other_lower == upper, separate);
            let [own, with_other_upper] = scores(form, [1, 5, 3]);
            assert_ne!(own, upper);
            assert_eq!(with_other_upper == lower, separate);
            let [upper_to_other, lower_to_other] = scores(form, [0, 2, 3]);
            assert!(upper_to_other != upper && lower_to_other != lower);
        }
    }

    #[test]
    fn a_vector_with_a_single_one_is_a_code() {
        let sizes =
            GptSizes { channels: 8, heads: 2, layers: 2, block: 2, codes: [3, 3], columns: 4 };
        let mut store = Store::default();
        let net = GptNet::new(&random_gpt(sizes, 7), &mut store);
        let parameters = Parameters::<Flex>::from_store(&store, &FlexDevice);
        let music = Tensor::full([1, 2, 4], 0.5, &FlexDevice);
        let codes = [[[2, 0]], [[1, 1]]].map(|codes| Tensor::from_ints(codes, &FlexDevice));
        let upper = Tensor::from_floats([[[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]], &FlexDevice);
        let lower = Tensor::from_floats([[[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]], &FlexDevice);
        let wanted = net.forward(&parameters, music.clone(), codes, 0.0);
        let found = net.regress(&parameters, music, [upper, lower], 0.0);
        for (found, wanted) in [(found.upper, wanted.upper), (found.lower, wanted.lower)] {
            let pairs = values(&found).into_iter().zip(values(&wanted));
            pairs.for_each(|(found, wanted)| assert!((found - wanted).abs() < 1e-6));
        }
    }

    #[test]
    fn one_code_has_one_score() {
        let [upper, lower] = scores(GptNet::with_one_code, [1, 2, 2]);
        assert_eq!(upper, lower);
        let [of_two, other] = scores(|net| net, [1, 2, 2]);
        assert_eq!(of_two, upper);
        assert_ne!(other, lower);
    }
}
