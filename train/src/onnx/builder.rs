//! Writes a graph node by node; values are referred to by name.

use bailando::model::WeightStorage;
use half::f16;
use prost::Message;

use super::{GraphError, InputRanges, proto};
use crate::HostTensor;

/// Operators and file format of a graph.
#[derive(Clone, Copy, Debug)]
pub(super) struct Version {
    opset: i64,
    /// The first IR version that goes with the opset.
    ir: i64,
}

impl Version {
    /// LayerNormalization came with 17, Split's `num_outputs` with 18, Gelu with 20.
    pub(super) const GELU: Self = Self { opset: 20, ir: 10 };
    /// Attention came with 23.
    pub(super) const ATTENTION: Self = Self { opset: 23, ir: 11 };
}

/// Name of a value inside a graph.
#[derive(Clone, Debug)]
pub(super) struct Value(String);

/// Size of one dimension of an input or output.
#[derive(Clone, Copy, Debug)]
pub(super) enum Dim<'a> {
    /// Known when the graph is written.
    Fixed(usize),
    /// Chosen by the caller.
    Named(&'a str),
}

/// Element type of an input or output.
#[derive(Clone, Copy, Debug)]
pub(super) enum Element {
    Float,
    Int,
}

/// An attribute's value.
#[derive(Clone, Copy, Debug)]
pub(super) enum Attribute<'a> {
    Int(i64),
    Ints(&'a [i64]),
    Float(f32),
    Text(&'a str),
}

/// Builds one graph.
#[derive(Debug)]
pub(super) struct GraphBuilder {
    graph: proto::Graph,
    storage: WeightStorage,
    ranges: InputRanges,
    version: Version,
    error: Option<GraphError>,
    values: usize,
}

impl GraphBuilder {
    pub(super) fn new(name: &str, storage: WeightStorage) -> Self {
        Self {
            graph: proto::Graph { name: name.to_owned(), ..proto::Graph::default() },
            storage,
            ranges: InputRanges::default(),
            version: Version::GELU,
            error: None,
            values: 0,
        }
    }

    /// With operators of another version.
    pub(super) fn with_version(self, version: Version) -> Self {
        Self { version, ..self }
    }

    /// With known ranges of what quantised matrices are multiplied with.
    pub(super) fn with_ranges(self, ranges: &InputRanges) -> Self {
        let ranges = ranges.clone();
        Self { ranges, ..self }
    }

    /// The model's bytes, or the first error met while building.
    pub(super) fn finish(self) -> Result<Vec<u8>, GraphError> {
        if let Some(error) = self.error {
            return Err(error);
        }
        let model = proto::Model {
            ir_version: self.version.ir,
            producer_name: env!("CARGO_PKG_NAME").to_owned(),
            producer_version: env!("CARGO_PKG_VERSION").to_owned(),
            graph: Some(self.graph),
            opset_import: vec![proto::OperatorSet {
                domain: String::new(),
                version: self.version.opset,
            }],
        };
        Ok(model.encode_to_vec())
    }

    pub(super) fn input(&mut self, name: &str, element: Element, shape: &[Dim<'_>]) -> Value {
        self.graph.input.push(value_info(name, element, shape));
        Value(name.to_owned())
    }

    /// Publishes `value` as the output `name`, which is its name from now on: passing it through an
    /// Identity could cost a copy of the whole cache at every step.
    pub(super) fn output(
        &mut self,
        name: &str,
        value: &Value,
        element: Element,
        shape: &[Dim<'_>],
    ) -> Value {
        self.graph.output.push(value_info(name, element, shape));
        for node in &mut self.graph.node {
            for used in node.input.iter_mut().chain(&mut node.output) {
                if *used == value.0 {
                    name.clone_into(used);
                }
            }
        }
        Value(name.to_owned())
    }

    /// A weight, stored as the model directory stores its weights.
    pub(super) fn weight(&mut self, name: &str, tensor: &HostTensor) -> Value {
        match self.storage {
            WeightStorage::F32 => self.float(name, tensor),
            WeightStorage::F16 | WeightStorage::Int8 => {
                let raw = self.half_bytes(name, tensor);
                let stored = format!("{name}.f16");
                self.initializer(&stored, tensor.shape(), proto::FLOAT16, raw);
                let to = ("to", Attribute::Int(i64::from(proto::FLOAT)));
                self.push_node("Cast", &[&Value(stored)], vec![name.to_owned()], &[to]);
                Value(name.to_owned())
            }
        }
    }

    /// Returns how weights are stored.
    pub(super) fn storage(&self) -> WeightStorage {
        self.storage
    }

    /// Returns the range of a matrix's input, where it is known.
    pub(super) fn range(&self, matrix: &str) -> Option<[f32; 2]> {
        self.ranges.of(matrix)
    }

    /// A constant that keeps full precision.
    pub(super) fn float(&mut self, name: &str, tensor: &HostTensor) -> Value {
        let raw = tensor.data().iter().flat_map(|v| v.to_le_bytes()).collect();
        self.initializer(name, tensor.shape(), proto::FLOAT, raw)
    }

    /// A constant vector of integers.
    pub(super) fn ints(&mut self, name: &str, values: &[i64]) -> Value {
        let raw = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.initializer(name, &[values.len()], proto::INT64, raw)
    }

    /// Applies an operator with one output.
    pub(super) fn apply(
        &mut self,
        operator: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute<'_>)],
    ) -> Value {
        let output = self.fresh(operator);
        self.push_node(operator, inputs, vec![output.clone()], attributes);
        Value(output)
    }

    /// Applies an operator with several outputs.
    pub(super) fn apply_for<const OUTPUTS: usize>(
        &mut self,
        operator: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute<'_>)],
    ) -> [Value; OUTPUTS] {
        let outputs: [Value; OUTPUTS] = std::array::from_fn(|_| Value(self.fresh(operator)));
        let names = outputs.iter().map(|output| output.0.clone()).collect();
        self.push_node(operator, inputs, names, attributes);
        outputs
    }

    /// Splits `value` into equal parts along `axis`.
    pub(super) fn split<const PARTS: usize>(&mut self, value: &Value, axis: i64) -> [Value; PARTS] {
        let attributes =
            [("axis", Attribute::Int(axis)), ("num_outputs", Attribute::Int(PARTS as i64))];
        self.apply_for("Split", &[value], &attributes)
    }

    fn fresh(&mut self, operator: &str) -> String {
        self.values += 1;
        format!("{operator}_{}", self.values)
    }

    fn push_node(
        &mut self,
        operator: &str,
        inputs: &[&Value],
        output: Vec<String>,
        attributes: &[(&str, Attribute<'_>)],
    ) {
        self.graph.node.push(proto::Node {
            input: inputs.iter().map(|value| value.0.clone()).collect(),
            name: output.first().cloned().unwrap_or_default(),
            output,
            op_type: operator.to_owned(),
            attribute: attributes.iter().map(|&(name, value)| attribute(name, value)).collect(),
        });
    }

    /// A constant of any type, its elements in little-endian order.
    pub(super) fn initializer(
        &mut self,
        name: &str,
        shape: &[usize],
        data_type: i32,
        raw: Vec<u8>,
    ) -> Value {
        self.graph.initializer.push(proto::TensorData {
            dims: shape.iter().map(|&size| size as i64).collect(),
            data_type,
            name: name.to_owned(),
            raw_data: raw,
        });
        Value(name.to_owned())
    }

    fn half_bytes(&mut self, name: &str, tensor: &HostTensor) -> Vec<u8> {
        let mut raw = Vec::with_capacity(2 * tensor.data().len());
        for &value in tensor.data() {
            let half = f16::from_f32(value);
            if !half.is_finite() && self.error.is_none() {
                self.error = Some(GraphError::HalfRange { weight: name.to_owned(), value });
            }
            raw.extend(half.to_le_bytes());
        }
        raw
    }
}

fn attribute(name: &str, value: Attribute<'_>) -> proto::Attribute {
    let mut attribute = proto::Attribute { name: name.to_owned(), ..proto::Attribute::default() };
    match value {
        Attribute::Int(value) => {
            attribute.i = Some(value);
            attribute.kind = proto::ATTRIBUTE_INT;
        }
        Attribute::Ints(values) => {
            attribute.ints = values.to_vec();
            attribute.kind = proto::ATTRIBUTE_INTS;
        }
        Attribute::Float(value) => {
            attribute.f = Some(value);
            attribute.kind = proto::ATTRIBUTE_FLOAT;
        }
        Attribute::Text(text) => {
            attribute.s = Some(text.as_bytes().to_vec());
            attribute.kind = proto::ATTRIBUTE_STRING;
        }
    }
    attribute
}

fn value_info(name: &str, element: Element, shape: &[Dim<'_>]) -> proto::ValueInfo {
    let dim = shape.iter().map(|dim| match *dim {
        Dim::Fixed(size) => proto::Dimension { value: Some(size as i64), name: None },
        Dim::Named(name) => proto::Dimension { value: None, name: Some(name.to_owned()) },
    });
    let tensor = proto::TensorKind {
        element: match element {
            Element::Float => proto::FLOAT,
            Element::Int => proto::INT64,
        },
        shape: Some(proto::Shape { dim: dim.collect() }),
    };
    proto::ValueInfo { name: name.to_owned(), kind: Some(proto::Kind { tensor: Some(tensor) }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weight_beyond_half_precision_is_refused() {
        let mut graph = GraphBuilder::new("g", WeightStorage::F16);
        graph.weight("w", &HostTensor::from_fn(vec![2], |_| 70_000.0));
        let error = graph.finish().unwrap_err();
        assert!(error.to_string().contains("weight `w` holds 70000"));
    }

    #[test]
    fn weights_of_half_precision_are_stored_without_loss() {
        let mut graph = GraphBuilder::new("g", WeightStorage::F16);
        let weights: Vec<f32> = (0..64).map(|i| f16::from_f32((i as f32).sin()).to_f32()).collect();
        graph.weight("w", &HostTensor::from_fn(vec![64], |i| weights[i]));
        let model = proto::Model::decode(&*graph.finish().unwrap()).unwrap();
        let stored = &model.graph.unwrap().initializer[0];
        assert_eq!(stored.data_type, proto::FLOAT16);
        let bytes = stored.raw_data.as_chunks::<2>().0.iter();
        let found: Vec<f32> = bytes.map(|&bytes| f16::from_le_bytes(bytes).to_f32()).collect();
        assert_eq!(found, weights);
    }

    #[test]
    fn a_written_model_decodes_to_what_was_built() {
        let mut graph = GraphBuilder::new("g", WeightStorage::F32);
        let x = graph.input("x", Element::Float, &[Dim::Named("n"), Dim::Fixed(2)]);
        let w = graph.weight("w", &HostTensor::from_fn(vec![2], |i| i as f32));
        let y = graph.apply("Softmax", &[&x], &[("axis", Attribute::Int(0))]);
        let z = graph.apply("Add", &[&y, &w], &[]);
        graph.output("z", &z, Element::Float, &[Dim::Named("n"), Dim::Fixed(2)]);
        let model = proto::Model::decode(&*graph.finish().unwrap()).unwrap();
        let graph = model.graph.unwrap();
        let operators: Vec<&str> = graph.node.iter().map(|node| &*node.op_type).collect();
        assert_eq!(operators, ["Softmax", "Add"]);
        assert_eq!(graph.node[1].output, ["z"]);
        // A zero is written, not left to the reader's default.
        assert_eq!(graph.node[0].attribute[0].i, Some(0));
        assert_eq!(graph.initializer[0].raw_data, [0, 0, 0, 0, 0, 0, 128, 63]);
    }
}
