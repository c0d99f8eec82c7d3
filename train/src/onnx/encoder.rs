//! Motion to codes (ARCHITECTURE section 2).

use bailando::model::WeightStorage;

use super::{
    GraphError,
    builder::{
        Attribute, Dim,
        Element::{Float, Int},
        GraphBuilder, Value,
    },
    decoder::{HALVING, PLAIN, convolve, stack},
};
use crate::{
    HostTensor,
    weights::{Convolution, EncoderWeights, HALF_JOINTS, HalfWeights, VqVaeWeights},
};

/// Coordinates of a joint.
const COORDINATES: usize = 3;

/// Writes `encoder.onnx`.
///
/// Input: `motion` float32 [batch, frames, 72], joints relative to the root; the root's own columns
/// count as zero whatever they hold. Models of the dancer's frame take joints that are turned to
/// face +z already, without the column of turns. Outputs: `upper`, `lower` int64 [batch, codes],
/// the nearest entries of the codebooks, the first one on ties.
///
/// # Errors
/// [`GraphError::HalfRange`].
pub fn encoder_graph(
    weights: &VqVaeWeights,
    storage: WeightStorage,
) -> Result<Vec<u8>, GraphError> {
    let (upper_joints, lower_joints) = HALF_JOINTS;
    let mut graph = GraphBuilder::new("pose_encoder", storage);
    let columns = COORDINATES * (upper_joints.len() + lower_joints.len());
    let shape = [Dim::Named("batch"), Dim::Named("frames"), Dim::Fixed(columns)];
    let motion = graph.input("motion", Float, &shape);
    let order = [("perm", Attribute::Ints(&[0, 2, 1]))];
    let motion = graph.apply("Transpose", &[&motion], &order);
    for (name, half, joints) in [
        ("upper", &weights.upper, upper_joints.as_slice()),
        ("lower", &weights.lower, lower_joints.as_slice()),
    ] {
        let codes = encode_half(&mut graph, name, half, joints, &motion);
        graph.output(name, &codes, Int, &[Dim::Named("batch"), Dim::Named("codes")]);
    }
    graph.finish()
}

fn encode_half(
    graph: &mut GraphBuilder,
    name: &str,
    half: &HalfWeights,
    joints: &[usize],
    motion: &Value,
) -> Value {
    let moving: Vec<usize> = joints.iter().copied().filter(|&joint| joint != 0).collect();
    let columns: Vec<i64> = moving
        .iter()
        .flat_map(|joint| (0..COORDINATES).map(move |c| (COORDINATES * joint + c) as i64))
        .collect();
    let columns = graph.ints(&format!("{name}.columns"), &columns);
    let input = graph.apply("Gather", &[motion, &columns], &[("axis", Attribute::Int(1))]);
    let still = COORDINATES * (joints.len() - moving.len());
    let hidden = encode(graph, name, &half.encoder, still, &input);
    nearest(graph, name, &half.codebook, &hidden)
}

/// `still` leading input columns are zero by definition, so the first convolution goes without
/// them.
fn encode(
    graph: &mut GraphBuilder,
    name: &str,
    weights: &EncoderWeights,
    still: usize,
    input: &Value,
) -> Value {
    let mut hidden = input.clone();
    for (level, layer) in weights.levels.iter().enumerate() {
        let name = format!("{name}.levels.{level}");
        let strided = match level {
            0 => without_inputs(&layer.strided, still),
            _ => layer.strided.clone(),
        };
        hidden = convolve(graph, &format!("{name}.strided"), &strided, &hidden, &HALVING);
        hidden = stack(graph, &name, &layer.stack, &hidden);
    }
    convolve(graph, &format!("{name}.output"), &weights.output, &hidden, &PLAIN)
}

/// The convolution without its first `count` input channels.
fn without_inputs(convolution: &Convolution, count: usize) -> Convolution {
    let weight = &convolution.weight;
    let (outputs, inputs, kernel) = (weight.dim(0), weight.dim(1), weight.dim(2));
    let left = inputs.saturating_sub(count);
    let kept = weight
        .data()
        .chunks_exact((inputs * kernel).max(1))
        .flat_map(|output| output.iter().skip(count * kernel).copied());
    let mut kept = kept.collect::<Vec<f32>>().into_iter();
    Convolution {
        weight: HostTensor::from_fn(vec![outputs, left, kernel], |_| kept.next().unwrap_or(0.0)),
        bias: convolution.bias.clone(),
    }
}

/// `argmin |x - e|^2` over the rows `e`; `|x|^2` is the same for all rows and left out.
fn nearest(graph: &mut GraphBuilder, name: &str, codebook: &HostTensor, hidden: &Value) -> Value {
    let vectors = graph.apply("Transpose", &[hidden], &[("perm", Attribute::Ints(&[0, 2, 1]))]);
    let codebook = graph.weight(&format!("{name}.codebook"), codebook);
    let axis = graph.ints(&format!("{name}.embedding_axis"), &[1]);
    let norms =
        graph.apply("ReduceSumSquare", &[&codebook, &axis], &[("keepdims", Attribute::Int(0))]);
    let columns = graph.apply("Transpose", &[&codebook], &[("perm", Attribute::Ints(&[1, 0]))]);
    let products = graph.apply("MatMul", &[&vectors, &columns], &[]);
    let twice = graph.apply("Add", &[&products, &products], &[]);
    let distances = graph.apply("Sub", &[&norms, &twice], &[]);
    let attributes = [
        ("axis", Attribute::Int(2)),
        ("keepdims", Attribute::Int(0)),
        ("select_last_index", Attribute::Int(0)),
    ];
    graph.apply("ArgMin", &[&distances], &attributes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leading_inputs_are_cut_from_a_convolution() {
        let whole = Convolution {
            weight: HostTensor::from_fn(vec![2, 3, 2], |i| i as f32),
            bias: HostTensor::from_fn(vec![2], |_| 0.0),
        };
        let cut = without_inputs(&whole, 2);
        assert_eq!(cut.weight.shape(), [2, 1, 2]);
        assert_eq!(cut.weight.data(), [4.0, 5.0, 10.0, 11.0]);
    }
}
