//! Checkpoints of a stage: one safetensors file that is replaced in one step.

use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, File},
    io::{self, Read, Write},
    path::Path,
};

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::Deserialize;

use super::{TrainError, config::RunConfig, runner::checkpoint_path};
use crate::{Tensor, nn::Store};

/// Where the facts are in the file's metadata, as JSON.
const FACTS: &str = "facts";
/// What a file is called while it is written.
const PARTIAL: &str = "partial";
/// Bytes before the header that say its length.
const LENGTH_BYTES: usize = 8;

/// What the library writes before the tensors, as far as we read it ourselves.
#[derive(Deserialize)]
struct Header {
    #[serde(rename = "__metadata__", default)]
    metadata: HashMap<String, String>,
}

/// Facts about a checkpoint.
pub(super) type Facts = BTreeMap<String, String>;

/// Writes beside `path`, then takes its place: a kill leaves the old file or the new one.
pub(super) fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let partial = path.with_extension(PARTIAL);
    let mut file = File::create(&partial)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&partial, path)
}

/// Removes what a kill left half written in a folder.
pub(super) fn remove_partial(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path
            .extension()
            .is_some_and(|extension| extension == PARTIAL)
        {
            fs::remove_file(path)?;
        }
    }
    Ok(())
}

/// Tensors by name, and facts about them.
#[derive(Clone, Debug, Default)]
pub(super) struct Saved {
    pub(super) tensors: BTreeMap<String, Tensor>,
    pub(super) facts: Facts,
}

impl Saved {
    /// The file's content, or nothing where there is no file.
    pub(super) fn read(path: &Path) -> Result<Option<Self>, TrainError> {
        let Some(bytes) = present(fs::read(path), path)? else {
            return Ok(None);
        };
        Self::parse(&bytes)
            .map(Some)
            .map_err(|message| TrainError::State {
                path: path.to_owned(),
                message,
            })
    }

    /// A stage's checkpoint to start from, which its extension tells from an official one.
    pub(super) fn of_extension(path: &Path) -> Result<Option<Self>, TrainError> {
        if path
            .extension()
            .is_none_or(|extension| extension != "safetensors")
        {
            return Ok(None);
        }
        let missing = || TrainError::file(path)(io::ErrorKind::NotFound.into());
        Self::read(path)?.ok_or_else(missing).map(Some)
    }

    /// The checkpoint of a finished stage.
    pub(super) fn finished(run: &RunConfig, stage: &'static str) -> Result<Self, TrainError> {
        let path = checkpoint_path(run, stage);
        let saved = Self::read(&path)?.filter(|saved| saved.fact("finished") == "true");
        saved.ok_or(TrainError::StageMissing { stage, path })
    }

    /// The facts alone, without reading the tensors; nothing where there is no file.
    pub(super) fn read_facts(path: &Path) -> Result<Option<Facts>, TrainError> {
        let Some(header) = present(read_header(path), path)? else {
            return Ok(None);
        };
        let header = serde_json::from_slice(&header).map_err(|error| error.to_string());
        let facts = header.and_then(|header: Header| parse_facts(&header.metadata));
        facts.map(Some).map_err(|message| TrainError::State {
            path: path.to_owned(),
            message,
        })
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
        Ok(Self {
            tensors,
            facts: parse_facts(header.metadata().as_ref().unwrap_or(&HashMap::new()))?,
        })
    }

    /// Replaces the file at `path` in one step.
    pub(super) fn write(&self, path: &Path) -> Result<(), TrainError> {
        let bytes = self.bytes().map_err(|message| TrainError::State {
            path: path.to_owned(),
            message,
        })?;
        replace_file(path, &bytes).map_err(TrainError::file(path))
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

/// Nothing in place of a file that is not there.
fn present<T>(read: io::Result<T>, path: &Path) -> Result<Option<T>, TrainError> {
    match read {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(TrainError::file(path)(error)),
    }
}

/// What the file says before the first tensor, as JSON.
fn read_header(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = File::open(path)?;
    let mut length = [0; LENGTH_BYTES];
    file.read_exact(&mut length)?;
    let mut header = Vec::new();
    file.take(u64::from_le_bytes(length))
        .read_to_end(&mut header)?;
    Ok(header)
}

fn parse_facts(metadata: &HashMap<String, String>) -> Result<Facts, String> {
    metadata.get(FACTS).map_or(Ok(Facts::new()), |facts| {
        serde_json::from_str(facts).map_err(|error| error.to_string())
    })
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
        assert_eq!(Saved::read_facts(&path).unwrap().unwrap(), saved.facts);
        fs::write(&path, b"longer nonsense").unwrap();
        assert!(matches!(Saved::read(&path), Err(TrainError::State { .. })));
        let facts = Saved::read_facts(&path);
        assert!(matches!(facts, Err(TrainError::State { .. })));
    }

    #[test]
    fn what_a_kill_left_half_written_goes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("loss.svg");
        replace_file(&path, b"whole").unwrap();
        fs::write(folder.path().join("best.partial"), b"ha").unwrap();
        remove_partial(folder.path()).unwrap();
        let left: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
        assert_eq!(left.len(), 1);
        assert_eq!(fs::read(&path).unwrap(), b"whole");
    }
}
