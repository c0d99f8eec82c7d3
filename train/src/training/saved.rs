//! Checkpoints of a stage: one safetensors file that is replaced in one step.

use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, File},
    io::Write,
    path::Path,
};

use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use super::{TrainError, config::RunConfig, runner::checkpoint_path};
use crate::{Tensor, nn::Store};

/// Where the facts are in the file's metadata, as JSON.
const FACTS: &str = "facts";

/// Tensors by name, and facts about them.
#[derive(Clone, Debug, Default)]
pub(super) struct Saved {
    pub(super) tensors: BTreeMap<String, Tensor>,
    pub(super) facts: BTreeMap<String, String>,
}

impl Saved {
    /// The file's content, or nothing where there is no file.
    pub(super) fn read(path: &Path) -> Result<Option<Self>, TrainError> {
        let bytes = match fs::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(TrainError::file(path)(error)),
        };
        Self::parse(&bytes)
            .map(Some)
            .map_err(|message| TrainError::State {
                path: path.to_owned(),
                message,
            })
    }

    /// The checkpoint of a finished stage.
    pub(super) fn finished(run: &RunConfig, stage: &'static str) -> Result<Self, TrainError> {
        let path = checkpoint_path(run, stage);
        let saved = Self::read(&path)?.filter(|saved| saved.fact("finished") == "true");
        saved.ok_or(TrainError::StageMissing { stage, path })
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let text = |error: safetensors::SafeTensorError| error.to_string();
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(text)?;
        let file = SafeTensors::deserialize(bytes).map_err(text)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            if view.dtype() != Dtype::F32 {
                return Err(format!("tensor `{name}` is not float32"));
            }
            let chunks = view.data().as_chunks::<4>().0.iter();
            let values = chunks.map(|&bytes| f32::from_le_bytes(bytes)).collect();
            let tensor = Tensor::new(view.shape().to_vec(), values);
            tensors.insert(name.to_owned(), tensor.map_err(|error| error.to_string())?);
        }
        let facts = header
            .metadata()
            .as_ref()
            .and_then(|facts| facts.get(FACTS));
        Ok(Self {
            tensors,
            facts: facts.map_or(Ok(BTreeMap::new()), |facts| {
                serde_json::from_str(facts).map_err(|error| error.to_string())
            })?,
        })
    }

    /// Writes beside `path`, then takes its place: a kill leaves the old file or the new one.
    pub(super) fn write(&self, path: &Path) -> Result<(), TrainError> {
        let partial = path.with_extension("partial");
        let bytes = self.bytes().map_err(|message| TrainError::State {
            path: path.to_owned(),
            message,
        })?;
        let write = || {
            let mut file = File::create(&partial)?;
            file.write_all(&bytes)?;
            file.sync_all()?;
            fs::rename(&partial, path)
        };
        write().map_err(TrainError::file(path))
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        let mut data: Vec<(&String, &Tensor, Vec<u8>)> = self
            .tensors
            .iter()
            .map(|(name, tensor)| {
                let bytes = tensor.data().iter().flat_map(|value| value.to_le_bytes());
                (name, tensor, bytes.collect())
            })
            .collect();
        data.sort_by_key(|(name, ..)| *name);
        let mut views = Vec::with_capacity(data.len());
        for (name, tensor, bytes) in &data {
            let view = TensorView::new(Dtype::F32, tensor.shape().to_vec(), bytes);
            views.push((*name, view.map_err(|error| error.to_string())?));
        }
        // One entry: the library writes several in any order, and equal runs give equal files.
        let facts = serde_json::to_string(&self.facts).map_err(|error| error.to_string())?;
        let facts = HashMap::from([(FACTS.to_owned(), facts)]);
        safetensors::serialize(views, Some(facts)).map_err(|error| error.to_string())
    }

    pub(super) fn fact(&self, name: &str) -> &str {
        self.facts.get(name).map_or("", String::as_str)
    }

    pub(super) fn tensor(&self, name: &str) -> Result<&Tensor, String> {
        self.tensors
            .get(name)
            .ok_or_else(|| format!("tensor `{name}` is missing"))
    }

    /// Values for all tensors of `store`, under its names with a prefix.
    pub(super) fn fill(&self, prefix: &str, store: &Store) -> Result<Store, String> {
        let mut values = Vec::with_capacity(store.entries().len());
        for (name, expected) in store.entries() {
            let found = self.tensor(&format!("{prefix}{name}"))?;
            if found.shape() != expected.shape() {
                let (wanted, found) = (expected.shape(), found.shape());
                return Err(format!(
                    "tensor `{name}`: expected {wanted:?}, found {found:?}"
                ));
            }
            values.push(found.data().to_vec());
        }
        Ok(store.with_values(values))
    }

    /// Takes in all tensors of `store`, under its names with a prefix.
    pub(super) fn put(&mut self, prefix: &str, store: &Store) {
        for (name, tensor) in store.entries() {
            self.tensors
                .insert(format!("{prefix}{name}"), tensor.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint.safetensors");
        assert!(Saved::read(&path).unwrap().is_none());
        let mut saved = Saved::default();
        let tensor = Tensor::from_fn(vec![2, 3], |flat| flat as f32 / 7.0);
        saved.tensors.insert("a".into(), tensor);
        saved.facts.insert("step".into(), "4".into());
        saved.write(&path).unwrap();
        let read = Saved::read(&path).unwrap().unwrap();
        assert_eq!(read.tensors, saved.tensors);
        assert_eq!(read.fact("step"), "4");
        fs::write(&path, b"nonsense").unwrap();
        assert!(matches!(Saved::read(&path), Err(TrainError::State { .. })));
    }
}
