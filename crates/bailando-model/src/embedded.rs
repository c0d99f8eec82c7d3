//! Checks an ONNX file before ONNX Runtime reads it: all values must lie in the file itself.
//!
//! The format lets a tensor name another file that holds its values. The manifest vouches for the
//! files that it lists and for no others, so such a graph is refused whatever the runtime would
//! make of the name. Nothing is kept of the file, and nothing allocated from what it declares.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, Seek},
    path::Path,
};

use super::ModelError;

/// Depth at which ONNX Runtime's own reader gives up.
const DEEPEST: usize = 100;

/// Refuses the graph at `path` if a tensor's values lie elsewhere.
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
                return Err(Fault::Graph("it is nested too deeply"));
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
    Graph(&'static str),
}

const CUT_OFF: Fault = Fault::Graph("it is damaged or cut off");
const ELSEWHERE: Fault = Fault::Graph("a tensor's values lie in another file, which is never read");

/// The messages of the public `onnx.proto` that a tensor can be inside of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Message {
    Model,
    Training,
    Function,
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
            (Self::Model, 7) | (Self::Training, 1 | 2) | (Self::Attribute, 6 | 11) => Self::Graph,
            (Self::Model, 20) => Self::Training,
            (Self::Model, 25) => Self::Function,
            (Self::Graph, 1) | (Self::Function, 7) => Self::Node,
            (Self::Node, 5) | (Self::Function, 11) => Self::Attribute,
            (Self::Graph, 15) | (Self::Attribute, 22 | 23) => Self::SparseTensor,
            (Self::Graph, 5) | (Self::Attribute, 5 | 10) | (Self::SparseTensor, 1 | 2) => {
                Self::Tensor
            }
            _ => return None,
        })
    }
}

/// `TensorProto.external_data` and `TensorProto.data_location`.
const EXTERNAL_DATA: u64 = 13;
const DATA_LOCATION: u64 = 14;

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
            return Err(CUT_OFF);
        }
        let size = match wire {
            0 => {
                let value = self.number()?;
                if (message, field) == (Message::Tensor, DATA_LOCATION) && value != 0 {
                    return Err(ELSEWHERE);
                }
                0
            }
            1 => 8,
            2 => self.number()?,
            5 => 4,
            _ => return Err(CUT_OFF),
        };
        let after = self.at.checked_add(size).filter(|&after| after <= end);
        let after = after.ok_or(CUT_OFF)?;
        if wire == 2 {
            if (message, field) == (Message::Tensor, EXTERNAL_DATA) {
                return Err(ELSEWHERE);
            }
            if let Some(inner) = message.inside(field) {
                return Ok(Some((inner, after)));
            }
        }
        let skipped = i64::try_from(size).map_err(|_| CUT_OFF)?;
        self.reader.seek_relative(skipped).map_err(Fault::Read)?;
        self.at = after;
        Ok(None)
    }

    /// A number of 7 bits a byte, the lowest first.
    fn number(&mut self) -> Result<u64, Fault> {
        let mut value = 0;
        for shift in (0..u64::BITS).step_by(7) {
            let mut byte = [0];
            self.reader.read_exact(&mut byte).map_err(|reason| match reason.kind() {
                io::ErrorKind::UnexpectedEof => CUT_OFF,
                _ => Fault::Read(reason),
            })?;
            self.at += 1;
            let [byte] = byte;
            let bits = u64::from(byte & 0x7f);
            if bits << shift >> shift != bits {
                return Err(CUT_OFF);
            }
            value |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(CUT_OFF)
    }
}
