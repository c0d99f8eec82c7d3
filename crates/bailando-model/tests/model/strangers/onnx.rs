//! The few fields of the ONNX format that the tests need, written byte by byte.

/// A field that holds bytes, a text or a message.
pub(crate) fn bytes(field: u64, content: &[u8]) -> Vec<u8> {
    let mut out = varint(field << 3 | 2);
    out.extend(varint(content.len() as u64));
    out.extend(content);
    out
}

/// A field that holds a number.
fn number(field: u64, value: u64) -> Vec<u8> {
    [varint(field << 3), varint(value)].concat()
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
    out
}

/// A `TensorProto` named `weight` whose values lie outside the file.
pub(crate) fn external_tensor(dims: &[u64], entries: &[(&str, &str)]) -> Vec<u8> {
    let mut tensor: Vec<u8> = dims.iter().flat_map(|&dim| number(1, dim)).collect();
    tensor.extend(number(2, 1));
    tensor.extend(bytes(8, b"weight"));
    for (key, value) in entries {
        let entry = [bytes(1, key.as_bytes()), bytes(2, value.as_bytes())].concat();
        tensor.extend(bytes(13, &entry));
    }
    tensor.extend(number(14, 1));
    tensor
}

/// A `TensorProto` named `weight` that holds its values.
pub(crate) fn tensor(dims: &[u64], values: &[f32]) -> Vec<u8> {
    let mut tensor: Vec<u8> = dims.iter().flat_map(|&dim| number(1, dim)).collect();
    tensor.extend(number(2, 1));
    tensor.extend(bytes(8, b"weight"));
    let raw: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    tensor.extend(bytes(9, &raw));
    tensor
}

/// A `ValueInfoProto` of floats, one dimension of any size.
fn value(name: &str) -> Vec<u8> {
    let dimension = bytes(1, &bytes(2, b"n"));
    let kind = bytes(1, &[number(1, 1), bytes(2, &dimension)].concat());
    [bytes(1, name.as_bytes()), bytes(2, &kind)].concat()
}

/// A `NodeProto`; `rest` are further fields.
pub(crate) fn node(operator: &str, inputs: &[&str], output: &str, rest: &[u8]) -> Vec<u8> {
    let mut node: Vec<u8> = inputs.iter().flat_map(|name| bytes(1, name.as_bytes())).collect();
    node.extend(bytes(2, output.as_bytes()));
    node.extend(bytes(4, operator.as_bytes()));
    node.extend(rest);
    node
}

/// A `ModelProto` of one graph: `motion` in, `codes` out.
pub(crate) fn model(graph: &[Vec<u8>]) -> Vec<u8> {
    let mut content = graph.concat();
    content.extend(bytes(2, b"graph"));
    content.extend(bytes(11, &value("motion")));
    content.extend(bytes(12, &value("codes")));
    let opset = [bytes(1, b""), number(2, 20)].concat();
    [number(1, 9), bytes(7, &content), bytes(8, &opset)].concat()
}

/// The node `codes = motion + weight`.
pub(crate) fn add() -> Vec<u8> {
    node("Add", &["motion", "weight"], "codes", &[])
}

/// A node that gives this `TensorProto` as `output`.
pub(crate) fn constant(output: &str, tensor: &[u8]) -> Vec<u8> {
    let attribute = [bytes(1, b"value"), bytes(5, tensor), number(20, 4)].concat();
    node("Constant", &[], output, &bytes(5, &attribute))
}

/// [`add`] with this `TensorProto` as the weight.
pub(crate) fn adding(tensor: &[u8]) -> Vec<u8> {
    model(&[bytes(1, &add()), bytes(5, tensor)])
}
