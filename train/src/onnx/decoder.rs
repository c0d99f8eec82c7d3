//! Codes to motion: both halves and the root's velocity (ARCHITECTURE section 2).

use bailando::model::WeightStorage;

use super::{
    GraphError,
    builder::{
        Attribute, Dim,
        Element::{Float, Int},
        GraphBuilder, Value,
    },
};
use crate::{
    HostTensor,
    weights::{Convolution, DecoderWeights, HALF_JOINTS, ResidualBlock, VqVaeWeights},
};

/// Coordinates of a joint.
const COORDINATES: usize = 3;

/// Writes `decoder.onnx`.
///
/// Inputs: `upper`, `lower` int64 [batch, codes]. Output: `motion` float32 [batch, frames, 72],
/// joint by joint, the root's velocity in the first three columns. What the root's decoder gives
/// beyond the velocity (the turn, in the dancer's frame) follows the joints.
///
/// # Errors
/// [`GraphError::HalfRange`].
pub fn decoder_graph(
    weights: &VqVaeWeights,
    storage: WeightStorage,
) -> Result<Vec<u8>, GraphError> {
    let mut graph = GraphBuilder::new("pose_decoder", storage);
    let codes = [Dim::Named("batch"), Dim::Named("codes")];
    let upper = graph.input("upper", Int, &codes);
    let lower = graph.input("lower", Int, &codes);
    let upper = embed(&mut graph, "upper.codebook", &weights.upper.codebook, &upper);
    let lower = embed(&mut graph, "lower.codebook", &weights.lower.codebook, &lower);

    let velocity = decode(&mut graph, "root", &weights.root, &lower);
    let lower = decode(&mut graph, "lower", &weights.lower.decoder, &lower);
    let upper = decode(&mut graph, "upper", &weights.upper.decoder, &upper);

    let channels = Attribute::Int(1);
    let all = graph.apply("Concat", &[&velocity, &lower, &upper], &[("axis", channels)]);
    let order = column_order(weights.root_columns());
    let columns = order.len();
    let order = graph.ints("column_order", &order);
    let ordered = graph.apply("Gather", &[&all, &order], &[("axis", channels)]);
    let motion = graph.apply("Transpose", &[&ordered], &[("perm", Attribute::Ints(&[0, 2, 1]))]);
    let shape = [Dim::Named("batch"), Dim::Named("frames"), Dim::Fixed(columns)];
    graph.output("motion", &motion, Float, &shape);
    graph.finish()
}

/// Where each motion column is found in turn among root, lower and upper columns.
fn column_order(root_columns: usize) -> Vec<i64> {
    let (upper, lower) = HALF_JOINTS;
    let mut order = vec![0; COORDINATES * (upper.len() + lower.len())];
    let halves = lower.iter().chain(&upper);
    for (place, &joint) in halves.enumerate() {
        // The root is the first joint of the lower half: its columns give way to the velocity.
        let source = if joint == 0 { 0 } else { root_columns + COORDINATES * place };
        for coordinate in 0..COORDINATES {
            if let Some(column) = order.get_mut(COORDINATES * joint + coordinate) {
                *column = (source + coordinate) as i64;
            }
        }
    }
    order.extend((COORDINATES..root_columns).map(|column| column as i64));
    order
}

/// Codes to their embeddings, `[batch, embedding, codes]`.
fn embed(graph: &mut GraphBuilder, name: &str, codebook: &HostTensor, codes: &Value) -> Value {
    let codebook = graph.weight(name, codebook);
    let rows = graph.apply("Gather", &[&codebook, codes], &[("axis", Attribute::Int(0))]);
    graph.apply("Transpose", &[&rows], &[("perm", Attribute::Ints(&[0, 2, 1]))])
}

fn decode(graph: &mut GraphBuilder, name: &str, weights: &DecoderWeights, input: &Value) -> Value {
    let mut hidden = convolve(graph, &format!("{name}.input"), &weights.input, input, &PLAIN);
    for (level, layer) in weights.levels.iter().enumerate() {
        let name = format!("{name}.levels.{level}");
        hidden = stack(graph, &name, &layer.stack, &hidden);
        hidden =
            convolve(graph, &format!("{name}.transposed"), &layer.transposed, &hidden, &DOUBLING);
    }
    convolve(graph, &format!("{name}.output"), &weights.output, &hidden, &PLAIN)
}

/// How a convolution moves along time.
pub(super) struct Motion {
    operator: &'static str,
    padding: i64,
    stride: i64,
    dilation: i64,
}

/// Kernel 3, keeps the length.
pub(super) const PLAIN: Motion = Motion::same(1);
/// Kernel 1.
const POINTWISE: Motion = Motion { operator: "Conv", padding: 0, stride: 1, dilation: 1 };
/// Kernel 4, halves the length.
pub(super) const HALVING: Motion = Motion { operator: "Conv", padding: 1, stride: 2, dilation: 1 };
/// Kernel 4, doubles the length.
const DOUBLING: Motion = Motion { operator: "ConvTranspose", ..HALVING };

impl Motion {
    /// Kernel 3 with `dilation`, keeps the length.
    const fn same(dilation: i64) -> Self {
        Self { operator: "Conv", padding: dilation, stride: 1, dilation }
    }
}

/// Residual blocks one after the other.
pub(super) fn stack(
    graph: &mut GraphBuilder,
    name: &str,
    blocks: &[ResidualBlock],
    input: &Value,
) -> Value {
    let mut hidden = input.clone();
    for (index, block) in blocks.iter().enumerate() {
        let name = format!("{name}.stack.{index}");
        let dilation = i64::try_from(block.dilation).unwrap_or(i64::MAX);
        let active = graph.apply("Relu", &[&hidden], &[]);
        let name_dilated = format!("{name}.dilated");
        let wide = convolve(graph, &name_dilated, &block.dilated, &active, &Motion::same(dilation));
        let active = graph.apply("Relu", &[&wide], &[]);
        let name_pointwise = format!("{name}.pointwise");
        let change = convolve(graph, &name_pointwise, &block.pointwise, &active, &POINTWISE);
        hidden = graph.apply("Add", &[&hidden, &change], &[]);
    }
    hidden
}

/// One convolution with its bias; zero padding at both ends.
pub(super) fn convolve(
    graph: &mut GraphBuilder,
    name: &str,
    weights: &Convolution,
    input: &Value,
    motion: &Motion,
) -> Value {
    let weight = graph.weight(&format!("{name}.weight"), &weights.weight);
    let bias = graph.weight(&format!("{name}.bias"), &weights.bias);
    let attributes = [
        ("pads", Attribute::Ints(&[motion.padding, motion.padding])),
        ("strides", Attribute::Ints(&[motion.stride])),
        ("dilations", Attribute::Ints(&[motion.dilation])),
    ];
    graph.apply(motion.operator, &[input, &weight, &bias], &attributes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_has_its_source() {
        let order = column_order(3);
        assert_eq!(order.len(), 72);
        // Velocity, left hip (second of the lower half), spine1 (first of the upper half).
        assert_eq!(order[..3], [0, 1, 2]);
        assert_eq!(order[3..6], [6, 7, 8]);
        assert_eq!(order[9..12], [30, 31, 32]);
        let mut sources = order.clone();
        sources.sort_unstable();
        // All but the root's own columns of the lower half.
        let expected: Vec<i64> = (0..3).chain(6..75).collect();
        assert_eq!(sources, expected);
    }

    #[test]
    fn the_turn_follows_the_joints() {
        let order = column_order(4);
        assert_eq!(order.len(), 73);
        assert_eq!(order[..3], [0, 1, 2]);
        assert_eq!(order[3..6], [7, 8, 9]);
        assert_eq!(order[72], 3);
        let mut sources = order;
        sources.sort_unstable();
        let expected: Vec<i64> = (0..4).chain(7..76).collect();
        assert_eq!(sources, expected);
    }
}
