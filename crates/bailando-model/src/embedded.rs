//! Checks an ONNX file before ONNX Runtime reads it: all values must lie in the file itself, and
//! all operators must be of those that the trainer writes.
//!
//! The format lets a tensor name another file that holds its values. The manifest vouches for the
//! files that it lists and for no others, so such a graph is refused whatever the runtime would
//! make of the name. It also has loops, and operators that make a large tensor of a small number:
//! they run without end or fill the memory as soon as the runtime folds constants, so graphs that
//! are inside of a graph, functions and all other operators are refused. Nothing is kept of the
//! file, and nothing allocated from what it declares.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, Seek},
    path::Path,
};

use super::ModelError;

/// Depth at which ONNX Runtime's own reader gives up.
const DEEPEST: usize = 100;

/// The operators of the graphs that the trainer writes, and `Constant`, which only holds a value.
const OPERATORS: [&str; 26] = [
    "Abs",
    "Add",
    "ArgMin",
    "Attention",
    "Cast",
    "Concat",
    "Constant",
    "Conv",
    "ConvTranspose",
    "DequantizeLinear",
    "Div",
    "Gather",
    "Gelu",
    "LayerNormalization",
    "MatMul",
    "MatMulInteger",
    "Max",
    "Mul",
    "QuantizeLinear",
    "ReduceMax",
    "ReduceSumSquare",
    "Relu",
    "Round",
    "Split",
    "Sub",
    "Transpose",
];

/// The longest operator name that is read, in bytes.
const LONGEST_NAME: u64 = 64;

/// Refuses the graph at `path` if a tensor's values lie elsewhere, or for an operator of its own.
pub(super) fn check(path: &Path) -> Result<(), ModelError> {
    let failed = |reason| ModelError::Read { path: path.to_path_buf(), reason };
    let file = File::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    match check_bytes(BufReader::new(file), length) {
        Ok(()) => Ok(()),
        Err(Fault::Read(reason)) => Err(failed(reason)),
        Err(Fault::Graph(problem)) => {
            Err(ModelError::GraphFile { path: path.to_path_buf(), problem })
        }
    }
}

/// The same for the `length` bytes of `reader`.
pub(crate) fn check_bytes(reader: impl BufRead + Seek, length: u64) -> Result<(), Fault> {
    let mut walk = Walk { reader, at: 0 };
    let mut open = vec![(Message::Model, length)];
    while let Some(&(message, end)) = open.last() {
        if walk.at == end {
            open.pop();
            continue;
        }
        match walk.field(message, end)? {
            Some(_) if open.len() == DEEPEST => {
                return Err(graph_fault("it is nested too deeply"));
            }
            inner => open.extend(inner),
        }
    }
    Ok(())
}

/// Why a graph was refused.
#[derive(Debug)]
pub(crate) enum Fault {
    Read(io::Error),
    Graph(String),
}

fn graph_fault(problem: impl Into<String>) -> Fault {
    Fault::Graph(problem.into())
}

fn cut_off() -> Fault {
    graph_fault("it is damaged or cut off")
}

fn elsewhere() -> Fault {
    graph_fault("a tensor's values lie in another file, which is never read")
}

/// The messages of the public `onnx.proto` that a tensor can be inside of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Message {
    Model,
    Graph,
    Node,
    Attribute,
    SparseTensor,
    Tensor,
}

impl Message {
    /// What the field with this number holds, if it is one of these messages.
    fn inside(self, field: u64) -> Option<Self> {
        Some(match (self, field) {
            (Self::Model, 7) => Self::Graph,
            (Self::Graph, 1) => Self::Node,
            (Self::Node, 5) => Self::Attribute,
            (Self::Graph, 15) | (Self::Attribute, 22 | 23) => Self::SparseTensor,
            (Self::Graph, 5) | (Self::Attribute, 5 | 10) | (Self::SparseTensor, 1 | 2) => {
                Self::Tensor
            }
            _ => return None,
        })
    }

    /// Why no file may have the field with this number.
    fn refusal(self, field: u64) -> Option<Fault> {
        Some(match (self, field) {
            (Self::Tensor, EXTERNAL_DATA) => elsewhere(),
            (Self::Model, 20 | 25) | (Self::Attribute, 6 | 11) => {
                graph_fault("it has graphs inside of the graph: loops, conditions or functions")
            }
            (Self::Node, 7) => graph_fault("it has operators of another domain"),
            _ => return None,
        })
    }
}

/// `TensorProto.external_data` and `TensorProto.data_location`.
const EXTERNAL_DATA: u64 = 13;
const DATA_LOCATION: u64 = 14;
/// `NodeProto.op_type`.
const OPERATOR: u64 = 4;

/// A place in the file.
struct Walk<R> {
    reader: R,
    at: u64,
}

impl<R: BufRead + Seek> Walk<R> {
    /// Reads the next field of `message`, which ends at `end`: skips it, or gives the message that
    /// starts here and where that ends.
    fn field(&mut self, message: Message, end: u64) -> Result<Option<(Message, u64)>, Fault> {
        let tag = self.number()?;
        let (field, wire) = (tag >> 3, tag & 7);
        // Other readers look at the lowest 32 bits alone: a longer tag must not mean two things.
        if field == 0 || tag > u64::from(u32::MAX) {
            return Err(cut_off());
        }
        let size = match wire {
            0 => {
                let value = self.number()?;
                if (message, field) == (Message::Tensor, DATA_LOCATION) && value != 0 {
                    return Err(elsewhere());
                }
                0
            }
            1 => 8,
            2 => self.number()?,
            5 => 4,
            _ => return Err(cut_off()),
        };
        let after = self.at.checked_add(size).filter(|&after| after <= end);
        let after = after.ok_or_else(cut_off)?;
        if wire == 2 {
            // An empty domain is the standard's own.
            if size > 0
                && let Some(refusal) = message.refusal(field)
            {
                return Err(refusal);
            }
            if let Some(inner) = message.inside(field) {
                return Ok(Some((inner, after)));
            }
            if (message, field) == (Message::Node, OPERATOR) {
                self.operator(size)?;
                return Ok(None);
            }
        }
        let skipped = i64::try_from(size).map_err(|_| cut_off())?;
        self.reader.seek_relative(skipped).map_err(Fault::Read)?;
        self.at = after;
        Ok(None)
    }

    /// Reads the name of an operator, and refuses all that graphs of ours do not have.
    fn operator(&mut self, size: u64) -> Result<(), Fault> {
        if size > LONGEST_NAME {
            return Err(graph_fault("an operator's name is too long"));
        }
        let name: Vec<u8> = (0..size).map(|_| self.byte()).collect::<Result<_, _>>()?;
        match OPERATORS.iter().any(|known| known.as_bytes() == name) {
            true => Ok(()),
            false => Err(graph_fault(format!(
                "the operator {:?} is none of those that bailando-train writes",
                String::from_utf8_lossy(&name)
            ))),
        }
    }

    fn byte(&mut self) -> Result<u8, Fault> {
        let mut byte = [0];
        self.reader.read_exact(&mut byte).map_err(|reason| match reason.kind() {
            io::ErrorKind::UnexpectedEof => cut_off(),
            _ => Fault::Read(reason),
        })?;
        self.at += 1;
        let [byte] = byte;
        Ok(byte)
    }

    /// A number of 7 bits a byte, the lowest first.
    fn number(&mut self) -> Result<u64, Fault> {
        let mut value = 0;
        for shift in (0..u64::BITS).step_by(7) {
            let byte = self.byte()?;
            let bits = u64::from(byte & 0x7f);
            if bits << shift >> shift != bits {
                return Err(cut_off());
            }
            value |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(cut_off())
    }
}
