//! Checkpoints of a stage: one safetensors file that is replaced in one step.

use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, File},
    io::{self, Read},
    path::Path,
};

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::Deserialize;

use super::{
    error::TrainError,
    files::{if_present, replace_file},
};
use crate::{HostTensor, nn::Store};

/// Entry of the file's metadata that holds the facts as JSON.
const FACTS: &str = "facts";
/// Bytes before the header that give its length.
const LENGTH_BYTES: usize = 8;

/// The header of a safetensors file, as far as it is read without the tensors.
#[derive(Deserialize)]
struct Header {
    #[serde(rename = "__metadata__", default)]
    metadata: HashMap<String, String>,
}

/// Facts about a checkpoint.
pub(super) type Facts = BTreeMap<String, String>;

/// Tensors by name, and facts about them.
#[derive(Clone, Debug, Default)]
pub(super) struct Checkpoint {
    pub(super) tensors: BTreeMap<String, HostTensor>,
    pub(super) facts: Facts,
}

impl Checkpoint {
    /// Reads a file; `None` where there is no file.
    pub(super) fn read(path: &Path) -> Result<Option<Self>, TrainError> {
        let bytes = if_present(fs::read(path)).map_err(TrainError::file(path))?;
        let parsed = bytes.map(|bytes| Self::parse(&bytes)).transpose();
        parsed.map_err(TrainError::state(path))
    }

    /// Reads the checkpoint of a stage; `None` for other extensions, which official checkpoints
    /// have.
    pub(super) fn of_extension(path: &Path) -> Result<Option<Self>, TrainError> {
        if path.extension().is_none_or(|extension| extension != "safetensors") {
            return Ok(None);
        }
        let missing = || TrainError::file(path)(io::ErrorKind::NotFound.into());
        Self::read(path)?.ok_or_else(missing).map(Some)
    }

    /// Reads the facts without the tensors; `None` where there is no file.
    pub(super) fn read_facts(path: &Path) -> Result<Option<Facts>, TrainError> {
        let header = if_present(read_header(path)).map_err(TrainError::file(path))?;
        let facts = header.map(|header| {
            let header: Header = serde_json::from_slice(&header).map_err(text)?;
            parse_facts(&header.metadata)
        });
        facts.transpose().map_err(TrainError::state(path))
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(text)?;
        let file = SafeTensors::deserialize(bytes).map_err(text)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            if view.dtype() != Dtype::F32 {
                return Err(format!("tensor `{name}` is not float32"));
            }
            let chunks = view.data().as_chunks::<4>().0.iter();
            let values = chunks.map(|&bytes| f32::from_le_bytes(bytes)).collect();
            let tensor = HostTensor::new(view.shape().to_vec(), values).map_err(text)?;
            tensors.insert(name.to_owned(), tensor);
        }
        Ok(Self {
            tensors,
            facts: parse_facts(header.metadata().as_ref().unwrap_or(&HashMap::new()))?,
        })
    }

    /// Replaces the file at `path` in one step.
    pub(super) fn write(&self, path: &Path) -> Result<(), TrainError> {
        let bytes = self.bytes().map_err(TrainError::state(path))?;
        replace_file(path, &bytes).map_err(TrainError::file(path))
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        let tensors = self.tensors.iter();
        let data: Vec<(&String, &HostTensor, Vec<u8>)> = tensors
            .map(|(name, tensor)| {
                let bytes = tensor.data().iter().flat_map(|value| value.to_le_bytes());
                (name, tensor, bytes.collect())
            })
            .collect();
        let mut views = Vec::with_capacity(data.len());
        for (name, tensor, bytes) in &data {
            let view = TensorView::new(Dtype::F32, tensor.shape().to_vec(), bytes);
            views.push((*name, view.map_err(text)?));
        }
        // One entry: the library writes several in any order, and equal runs give equal files.
        let facts = serde_json::to_string(&self.facts).map_err(text)?;
        let facts = HashMap::from([(FACTS.to_owned(), facts)]);
        safetensors::serialize(views, Some(facts)).map_err(text)
    }

    /// Returns a fact; empty where the checkpoint does not have it.
    #[cfg(test)]
    pub(super) fn fact(&self, name: &str) -> &str {
        self.facts.get(name).map_or("", String::as_str)
    }

    /// Returns a tensor, or a message that it is missing.
    pub(super) fn tensor(&self, name: &str) -> Result<&HostTensor, String> {
        let tensor = self.tensors.get(name);
        tensor.ok_or_else(|| format!("tensor `{name}` is missing"))
    }

    /// Adds rows of `width` values.
    pub(super) fn put_rows(&mut self, name: &str, width: usize, values: &[f32]) {
        let shape = vec![values.len() / width, width];
        let tensor = HostTensor::from_fn(shape, |place| values[place]);
        self.tensors.insert(name.into(), tensor);
    }

    /// Adds a vector.
    pub(super) fn put_vector(&mut self, name: &str, values: &[f32]) {
        let tensor = HostTensor::from_fn(vec![values.len()], |place| values[place]);
        self.tensors.insert(name.into(), tensor);
    }

    /// Adds all tensors of `store`, under its names with a prefix.
    pub(super) fn put_store(&mut self, prefix: &str, store: &Store) {
        let entries = store.entries().iter();
        let named = entries.map(|(name, tensor)| (format!("{prefix}{name}"), tensor.clone()));
        self.tensors.extend(named);
    }

    /// Returns `store` with the values found under its names with a prefix.
    pub(super) fn fill(&self, prefix: &str, store: &Store) -> Result<Store, String> {
        let mut values = Vec::with_capacity(store.entries().len());
        for (name, expected) in store.entries() {
            let found = self.tensor(&format!("{prefix}{name}"))?;
            if found.shape() != expected.shape() {
                let (wanted, found) = (expected.shape(), found.shape());
                return Err(format!("tensor `{name}`: expected {wanted:?}, found {found:?}"));
            }
            values.push(found.data().to_vec());
        }
        Ok(store.with_values(values))
    }
}

/// Reads what the file holds before the first tensor, as JSON.
fn read_header(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = File::open(path)?;
    let mut length = [0; LENGTH_BYTES];
    file.read_exact(&mut length)?;
    let mut header = Vec::new();
    file.take(u64::from_le_bytes(length)).read_to_end(&mut header)?;
    Ok(header)
}

fn parse_facts(metadata: &HashMap<String, String>) -> Result<Facts, String> {
    let facts = metadata.get(FACTS).map_or("{}", String::as_str);
    serde_json::from_str(facts).map_err(text)
}

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_checkpoint_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint.safetensors");
        assert!(Checkpoint::read(&path).unwrap().is_none());
        let mut checkpoint = Checkpoint::default();
        checkpoint.put_rows("a", 3, &[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
        checkpoint.facts.insert("step".into(), "4".into());
        checkpoint.write(&path).unwrap();
        let read = Checkpoint::read(&path).unwrap().unwrap();
        assert_eq!(read.tensors, checkpoint.tensors);
        assert_eq!(read.fact("step"), "4");
        assert_eq!(Checkpoint::read_facts(&path).unwrap().unwrap(), checkpoint.facts);
        fs::write(&path, b"longer nonsense").unwrap();
        assert!(matches!(Checkpoint::read(&path), Err(TrainError::State { .. })));
        let facts = Checkpoint::read_facts(&path);
        assert!(matches!(facts, Err(TrainError::State { .. })));
    }
}
