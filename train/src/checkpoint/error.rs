//! What can be wrong with a checkpoint file.

use std::path::PathBuf;

/// What can be wrong with a checkpoint file: always one line that names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each message names its fields")]
pub enum CheckpointError {
    /// The file could not be read.
    #[error("{}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    /// The file is not a checkpoint that this reader understands, or it is damaged.
    #[error("{}: {problem}", path.display())]
    Malformed { path: PathBuf, problem: Problem },
    /// A tensor that the model needs is not there.
    #[error("{}: tensor `{tensor}` is missing", path.display())]
    MissingTensor { path: PathBuf, tensor: String },
    /// A tensor has another shape than its neighbours ask for.
    #[error("{}: tensor `{tensor}` should be {expected}, but is {found:?}", path.display())]
    Shape { path: PathBuf, tensor: String, expected: String, found: Vec<usize> },
    /// One tensor's values cannot be read.
    #[error("{}: tensor `{tensor}`: {problem}", path.display())]
    Tensor { path: PathBuf, tensor: String, problem: Problem },
}

/// What is wrong inside a checkpoint.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each message names its fields")]
pub enum Problem {
    /// Neither container starts like this.
    #[error("this is neither a zip nor a legacy PyTorch checkpoint")]
    UnknownContainer,
    /// The zip archive is damaged.
    #[error("the zip archive is damaged or cut off: {0}")]
    Zip(String),
    /// An entry is compressed or encrypted; PyTorch stores plainly.
    #[error("zip entry `{0}` is compressed or encrypted, PyTorch stores its entries plainly")]
    NotStored(String),
    /// An entry is missing.
    #[error("zip entry `{0}` is missing")]
    MissingEntry(String),
    /// An entry claims to be larger than the file that holds it.
    #[error("zip entry `{entry}` claims {declared} bytes, but only {available} are there")]
    EntrySize { entry: String, declared: u64, available: u64 },
    /// The file was written on a big-endian machine.
    #[error("the values are not little-endian")]
    ByteOrder,
    /// The pickle ends too early.
    #[error("the pickle is cut off at byte {0}")]
    Truncated(usize),
    /// An opcode outside the subset that plain data needs.
    #[error("pickle opcode 0x{opcode:02x} at byte {offset} is not one that plain data needs")]
    Opcode { opcode: u8, offset: usize },
    /// Code that the file asks for, beside what NumPy arrays need.
    #[error("it asks for `{0}`, which an array file has no use for; nothing was run")]
    Global(String),
    /// The pickle's instructions contradict each other.
    #[error("malformed pickle at byte {offset}: {what}")]
    Pickle { offset: usize, what: &'static str },
    /// The pickle is far larger than any state dictionary.
    #[error("the pickle has {bytes} bytes, at most {limit} are accepted")]
    PickleSize { bytes: u64, limit: u64 },
    /// The pickled object holds no tensors where they are expected.
    #[error("no dictionary of tensors inside (expected under the key `model`)")]
    NoTensors,
    /// Two tensors have the same name once `module.` is cut off.
    #[error("tensor `{0}` occurs twice")]
    Duplicate(String),
    /// A storage's bytes are missing or do not fit what was declared.
    #[error("storage `{key}` should have {expected} bytes, but {found} are there")]
    StorageSize { key: String, expected: u64, found: u64 },
    /// The list of storages at the end of a legacy file is damaged.
    #[error("the list of storages is damaged at byte {0}")]
    StorageList(usize),
    /// The tensor's offset, shape and strides lie outside its storage.
    #[error(
        "shape {shape:?} with strides {strides:?} at {offset} lies outside its storage of {values} \
         values"
    )]
    OutsideStorage { shape: Vec<usize>, strides: Vec<usize>, offset: usize, values: usize },
    /// Tensors that share their storages have more values together than the file has bytes.
    #[error("the tensors hold more than the {0} values that a file of as many bytes may")]
    Amplified(usize),
    /// The values are integers or of another kind that weights are not.
    #[error("holds {0} values, expected floating point")]
    NotFloat(&'static str),
    /// A value is infinite or not a number.
    #[error("holds values that are not finite")]
    NotFinite,
}
