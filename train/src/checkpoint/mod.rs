//! Official PyTorch checkpoints (ARCHITECTURE section 4), read without executing anything.
//!
//! Three containers are understood: the zip archive, the older file of concatenated pickles and raw
//! storages, and safetensors. Sizes that a file declares are compared with the bytes that are there
//! before anything is allocated, and tensors are decoded one at a time when asked for. Tensors may
//! share a storage, but all that were asked for have no more values than the file has bytes, so the
//! memory needed is bounded by the size of the file.

mod container;
mod error;
mod legacy;
mod names;
pub(crate) mod pickle;
mod safe;
mod view;
mod zipped;

pub use error::{CheckpointError, Problem};

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use crate::host_tensor::{HostTensor, elements};
use container::Container;
use pickle::TensorView;

/// An opened checkpoint: its tensors by name, without what wrappers add (`module.`, `_orig_mod.`).
#[derive(Debug)]
pub struct TorchCheckpoint {
    path: PathBuf,
    container: Container,
    views: BTreeMap<String, TensorView>,
    /// Bytes of the file.
    length: usize,
    /// Values of the tensors asked for so far.
    asked: usize,
    /// Their names: asking again costs nothing.
    names_asked: BTreeSet<String>,
}

impl TorchCheckpoint {
    /// Opens the checkpoint at `path`.
    ///
    /// # Errors
    /// [`CheckpointError::Read`] or [`CheckpointError::Malformed`].
    pub fn open(path: &Path) -> Result<Self, CheckpointError> {
        let bytes = std::fs::read(path)
            .map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
        Self::from_bytes(path, bytes)
    }

    /// Opens a checkpoint in memory; `path` is what errors call it.
    ///
    /// # Errors
    /// [`CheckpointError::Malformed`].
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self, CheckpointError> {
        let length = bytes.len();
        let (container, views) = Container::open(bytes)
            .map_err(|problem| CheckpointError::Malformed { path: path.to_owned(), problem })?;
        Ok(Self {
            path: path.to_owned(),
            container,
            views,
            length,
            asked: 0,
            names_asked: BTreeSet::new(),
        })
    }

    /// The file's path, for messages.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Names of all tensors, ascending.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.views.keys().map(String::as_str)
    }

    /// Whether a tensor of this name is there.
    #[must_use]
    pub fn contains(&self, name: &str) -> bool {
        self.views.contains_key(name)
    }

    /// Decodes one tensor to float32.
    ///
    /// # Errors
    /// [`CheckpointError::MissingTensor`], or [`CheckpointError::Tensor`] when its values cannot
    /// be read.
    pub fn tensor(&mut self, name: &str) -> Result<HostTensor, CheckpointError> {
        let Some(view) = self.views.get(name) else {
            return Err(CheckpointError::MissingTensor {
                path: self.path.clone(),
                tensor: name.to_owned(),
                hint: if names::is_shard(&self.path) { error::PART } else { "" },
            });
        };
        let mut allowed = || {
            if self.names_asked.insert(name.to_owned()) {
                let values = elements(&view.shape).unwrap_or(usize::MAX);
                self.asked = self.asked.saturating_add(values);
            }
            match self.asked <= self.length {
                true => Ok(()),
                false => Err(Problem::Amplified(self.length)),
            }
        };
        let decoded = view::check(view)
            .and_then(|()| allowed())
            .and_then(|()| self.container.storage(&view.storage))
            .and_then(|bytes| view::decode(view, &bytes));
        decoded.map_err(|problem| CheckpointError::Tensor {
            path: self.path.clone(),
            tensor: name.to_owned(),
            problem,
        })
    }
}

#[cfg(test)]
mod tests;
