//! What can be wrong with a checkpoint file.

use std::path::PathBuf;

/// What to say of a checkpoint in several files, and of one of these.
const JOIN: &str = "load all parts into one dictionary and save it with \
                    safetensors.torch.save_file";
pub(super) const PART: &str = " in this part of a checkpoint in several files: load all parts into \
                               one dictionary and save it with safetensors.torch.save_file";

/// What can be wrong with a checkpoint file: always one line that names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages are the documentation")]
pub enum CheckpointError {
    #[error("{}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: {problem}", path.display())]
    Malformed { path: PathBuf, problem: Problem },
    #[error("{}: tensor `{tensor}` is missing{hint}", path.display())]
    MissingTensor { path: PathBuf, tensor: String, hint: &'static str },
    #[error("{}: tensor `{tensor}` should be {expected}, but is {found:?}", path.display())]
    Shape { path: PathBuf, tensor: String, expected: String, found: Vec<usize> },
    #[error("{}: tensor `{tensor}`: {problem}", path.display())]
    Tensor { path: PathBuf, tensor: String, problem: Problem },
}

/// What is wrong inside a checkpoint.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages are the documentation")]
pub enum Problem {
    #[error(
        "this is no checkpoint: expected what torch.save writes (zip or the older container), or \
         safetensors"
    )]
    UnknownContainer,
    #[error(
        "this is a TorchScript archive (torch.jit.save), a program with weights inside: save the \
         weights alone, torch.save(model.state_dict(), 'weights.pt')"
    )]
    TorchScript,
    #[error("this is the index of a checkpoint in several files ({0}): {join}", join = JOIN)]
    ShardIndex(String),
    #[error("the safetensors file is damaged or cut off: {0}")]
    Safetensors(String),
    #[error("a tensor holds {0} values, expected F32, F16, BF16 or F64")]
    Dtype(String),
    #[error("the zip archive is damaged or cut off: {0}")]
    Zip(String),
    #[error("zip entry `{0}` is compressed or encrypted, PyTorch stores its entries plainly")]
    NotStored(String),
    #[error("zip entry `{0}` is missing")]
    MissingEntry(String),
    #[error("zip entry `{entry}` claims {declared} bytes, but only {available} are there")]
    EntrySize { entry: String, declared: u64, available: u64 },
    #[error("the values are not little-endian")]
    ByteOrder,
    #[error("the pickle is cut off at byte {0}")]
    Truncated(usize),
    #[error("pickle opcode 0x{opcode:02x} at byte {offset} is not one that plain data needs")]
    Opcode { opcode: u8, offset: usize },
    #[error("it asks for `{0}`, which an array file has no use for; nothing was run")]
    Global(String),
    #[error("malformed pickle at byte {offset}: {what}")]
    Pickle { offset: usize, what: &'static str },
    #[error("the pickle has {bytes} bytes, at most {limit} are accepted")]
    PickleSize { bytes: u64, limit: u64 },
    #[error("no dictionary of tensors inside (expected under the key `model`)")]
    NoTensors,
    #[error("tensor `{0}` occurs twice")]
    Duplicate(String),
    #[error("storage `{key}` should have {expected} bytes, but {found} are there")]
    StorageSize { key: String, expected: u64, found: u64 },
    #[error("the list of storages is damaged at byte {0}")]
    StorageList(usize),
    #[error(
        "shape {shape:?} with strides {strides:?} at {offset} lies outside its storage of {values} \
         values"
    )]
    OutsideStorage { shape: Vec<usize>, strides: Vec<usize>, offset: usize, values: usize },
    #[error("the tensors hold more than the {0} values that a file of as many bytes may")]
    Amplified(usize),
    #[error("holds {0} values, expected floating point")]
    NotFloat(&'static str),
    #[error("it is no graph of a model directory, or damaged: {0}")]
    Onnx(String),
    #[error("holds values that are not finite")]
    NotFinite,
}
