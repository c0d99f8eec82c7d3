//! The motion GPT as one graph for priming with many steps and for single steps
//! (ARCHITECTURE section 3).
//!
//! Tokens of a run are ordered music, upper, lower; keys and values of earlier runs come in as
//! `past_*` and go out, extended, as `present_*`. Which token sees which is the caller's to say
//! through `attention_bias`: within a step nothing is hidden, priming hides the future.

use bailando::model::WeightStorage;

use super::{
    GraphError, InputRanges,
    builder::{
        Attribute, Dim,
        Element::{Float, Int},
        GraphBuilder, Value, Version,
    },
};
use crate::{
    HostTensor,
    weights::{Block, GptWeights, LayerNorm, Linear},
};

const LAYER_NORM_EPSILON: f32 = 1e-5;

/// Writes `gpt.onnx`.
///
/// Inputs: `upper`, `lower`, `positions` int64 [batch, steps]; `music` float32 [batch, steps,
/// columns]; `attention_bias` float32 [batch or 1, 1, 3 x steps, 3 x (past + steps)], added to the
/// scaled scores; `past_key.i`, `past_value.i` float32 [batch, heads, past tokens, head size] for
/// every block, those of the state network first. Products with 8-bit matrices know the range of
/// what they multiply from `ranges`, or find it row by row. Outputs: `upper_logits`, `lower_logits`
/// [batch, steps, vocabulary]; `present_key.i`, `present_value.i`, the past with the new tokens
/// after it.
///
/// # Errors
/// [`GraphError::HalfRange`].
pub fn gpt_graph(
    weights: &GptWeights,
    storage: WeightStorage,
    ranges: &InputRanges,
) -> Result<Vec<u8>, GraphError> {
    let mut gpt = GptGraph {
        graph: GraphBuilder::new("motion_gpt", storage)
            .with_version(Version::ATTENTION)
            .with_ranges(ranges),
        weights,
    };
    let tokens = gpt.embeddings();
    let bias = gpt.attention_bias();
    let mut hidden = tokens;
    for (layer, block) in weights.blocks.iter().enumerate() {
        hidden = gpt.block(layer, block, &hidden, &bias);
    }
    gpt.logits(&hidden);
    gpt.graph.finish()
}

struct GptGraph<'a> {
    graph: GraphBuilder,
    weights: &'a GptWeights,
}

impl GptGraph<'_> {
    /// The three streams with their positions, one after the other: `[batch, 3 x steps, channels]`.
    fn embeddings(&mut self) -> Value {
        let steps = [Dim::Named("batch"), Dim::Named("steps")];
        let columns = Dim::Fixed(self.weights.columns());
        let upper = self.graph.input("upper", Int, &steps);
        let lower = self.graph.input("lower", Int, &steps);
        let music_shape = [steps.as_slice(), &[columns]].concat();
        let music = self.graph.input("music", Float, &music_shape);
        let positions = self.graph.input("positions", Int, &steps);

        let weights = self.weights;
        let music = self.music(&weights.music, &music);
        let upper = self.gather("upper_embedding", &weights.upper_embedding, &upper);
        let lower = self.gather("lower_embedding", &weights.lower_embedding, &lower);
        let block = weights.block();
        let mut streams = Vec::new();
        for (stream, (name, value)) in
            [("music", music), ("upper", upper), ("lower", lower)].into_iter().enumerate()
        {
            // One table a stream: a position outside its block is an error, not another stream's.
            let table = weights.positions.rows(stream * block, (stream + 1) * block);
            let place = self.gather(&format!("{name}_positions"), &table, &positions);
            streams.push(self.graph.apply("Add", &[&value, &place], &[]));
        }
        let streams: Vec<&Value> = streams.iter().collect();
        self.graph.apply("Concat", &streams, &[("axis", Attribute::Int(1))])
    }

    /// Never quantised: raw columns differ in scale by orders of magnitude, and one scale for all
    /// of them would leave nothing of the small ones.
    fn music(&mut self, linear: &Linear, rows: &Value) -> Value {
        let matrix = self.graph.weight("music.weight", &linear.weight.transposed());
        let bias = self.graph.weight("music.bias", &linear.bias);
        let product = self.graph.apply("MatMul", &[rows, &matrix], &[]);
        self.graph.apply("Add", &[&product, &bias], &[])
    }

    fn attention_bias(&mut self) -> Value {
        let shape = [
            Dim::Named("bias_batch"),
            Dim::Fixed(1),
            Dim::Named("new_tokens"),
            Dim::Named("all_tokens"),
        ];
        self.graph.input("attention_bias", Float, &shape)
    }

    fn block(&mut self, layer: usize, block: &Block, hidden: &Value, bias: &Value) -> Value {
        let name = format!("blocks.{layer}");
        let normal =
            self.layer_norm(&format!("{name}.attention_norm"), &block.attention_norm, hidden);
        let attended = self.attention(layer, block, &normal, bias);
        let hidden = self.graph.apply("Add", &[hidden, &attended], &[]);

        let normal = self.layer_norm(&format!("{name}.mlp_norm"), &block.mlp_norm, &hidden);
        let wide = self.linear(&format!("{name}.mlp_in"), &block.mlp_in, &normal);
        let exact = [("approximate", Attribute::Text("none"))];
        let active = self.graph.apply("Gelu", &[&wide], &exact);
        let narrow = self.linear(&format!("{name}.mlp_out"), &block.mlp_out, &active);
        self.graph.apply("Add", &[&hidden, &narrow], &[])
    }

    fn attention(&mut self, layer: usize, block: &Block, input: &Value, bias: &Value) -> Value {
        let name = format!("blocks.{layer}");
        // One product for all three: reading weights is what a single step spends its time on.
        let fused = Linear {
            weight: HostTensor::stacked(&[
                &block.query.weight,
                &block.key.weight,
                &block.value.weight,
            ]),
            bias: HostTensor::stacked(&[&block.query.bias, &block.key.bias, &block.value.bias]),
        };
        let fused = self.linear(&format!("{name}.query_key_value"), &fused, input);
        let [query, key, value] = self.graph.split::<3>(&fused, 2);
        let [past_key, past_value] = ["key", "value"].map(|kind| self.past(kind, layer));
        let heads = Attribute::Int(self.weights.heads as i64);
        let heads = [("q_num_heads", heads), ("kv_num_heads", heads)];
        // It scales by the root of the head size, and appends keys and values to the past.
        let inputs = [&query, &key, &value, bias, &past_key, &past_value];
        let [mixed, key, value] = self.graph.apply_for("Attention", &inputs, &heads);
        for (kind, present) in [("key", key), ("value", value)] {
            let name = format!("present_{kind}.{layer}");
            let shape = self.cache_shape("all_tokens");
            self.graph.output(&name, &present, Float, &shape);
        }
        self.linear(&format!("{name}.projection"), &block.projection, &mixed)
    }

    fn past(&mut self, kind: &str, layer: usize) -> Value {
        let shape = self.cache_shape("past_tokens");
        self.graph.input(&format!("past_{kind}.{layer}"), Float, &shape)
    }

    /// `[batch, heads, tokens, head size]`.
    fn cache_shape(&self, tokens: &'static str) -> [Dim<'static>; 4] {
        [
            Dim::Named("batch"),
            Dim::Fixed(self.weights.heads),
            Dim::Named(tokens),
            Dim::Fixed(self.weights.head_size()),
        ]
    }

    /// Upper logits from the upper third of the tokens, lower logits from the lower third.
    fn logits(&mut self, hidden: &Value) {
        let weights = self.weights;
        let normal = self.layer_norm("final_norm", &weights.final_norm, hidden);
        let [_music, upper, lower] = self.graph.split::<3>(&normal, 1);
        for (name, head, third) in
            [("upper", &weights.upper_head, upper), ("lower", &weights.lower_head, lower)]
        {
            let logits = self.graph.product(&format!("{name}_head"), &head.transposed(), &third);
            let shape = [Dim::Named("batch"), Dim::Named("steps"), Dim::Fixed(head.dim(0))];
            self.graph.output(&format!("{name}_logits"), &logits, Float, &shape);
        }
    }

    fn linear(&mut self, name: &str, linear: &Linear, input: &Value) -> Value {
        let matrix = linear.weight.transposed();
        let product = self.graph.product(&format!("{name}.weight"), &matrix, input);
        let bias = self.graph.weight(&format!("{name}.bias"), &linear.bias);
        self.graph.apply("Add", &[&product, &bias], &[])
    }

    fn layer_norm(&mut self, name: &str, norm: &LayerNorm, input: &Value) -> Value {
        let weight = self.graph.weight(&format!("{name}.weight"), &norm.weight);
        let bias = self.graph.weight(&format!("{name}.bias"), &norm.bias);
        let attributes =
            [("axis", Attribute::Int(-1)), ("epsilon", Attribute::Float(LAYER_NORM_EPSILON))];
        self.graph.apply("LayerNormalization", &[input, &weight, &bias], &attributes)
    }

    fn gather(&mut self, name: &str, table: &HostTensor, rows: &Value) -> Value {
        let table = self.graph.weight(name, table);
        self.graph.apply("Gather", &[&table, rows], &[("axis", Attribute::Int(0))])
    }
}
