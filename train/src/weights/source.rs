//! Tensors of a checkpoint by name, with their shapes checked.

use std::path::Path;

use crate::{
    HostTensor,
    checkpoint::{CheckpointError, TorchCheckpoint},
};

/// A file of named tensors.
pub(crate) trait Tensors {
    /// The file's path, for messages.
    fn path(&self) -> &Path;

    /// Whether a tensor of this name is there.
    fn contains(&self, name: &str) -> bool;

    /// Returns one tensor as float32.
    fn tensor(&mut self, name: &str) -> Result<HostTensor, CheckpointError>;
}

impl Tensors for TorchCheckpoint {
    fn path(&self) -> &Path {
        self.path()
    }

    fn contains(&self, name: &str) -> bool {
        self.contains(name)
    }

    fn tensor(&mut self, name: &str) -> Result<HostTensor, CheckpointError> {
        self.tensor(name)
    }
}

/// A size that a shape must have, or that it decides.
#[derive(Clone, Copy, Debug)]
pub(super) enum Size {
    /// Exactly this.
    Is(usize),
    /// At least the first, at most the second.
    Between(usize, usize),
    /// Whatever the file says, but not zero; the name is used in messages.
    Any(&'static str),
}

/// Takes checked tensors out of a file.
pub(super) struct Source<'a> {
    file: &'a mut dyn Tensors,
}

impl<'a> Source<'a> {
    pub(super) fn new(file: &'a mut dyn Tensors) -> Self {
        Self { file }
    }

    pub(super) fn path(&self) -> &Path {
        self.file.path()
    }

    /// Takes the tensor `name`, whose shape must match `shape`.
    pub(super) fn take(
        &mut self,
        name: &str,
        shape: &[Size],
    ) -> Result<HostTensor, CheckpointError> {
        let tensor = self.file.tensor(name)?;
        let fits = tensor.shape().len() == shape.len()
            && tensor.shape().iter().zip(shape).all(|(&found, size)| match *size {
                Size::Is(expected) => found == expected,
                Size::Between(least, most) => (least..=most).contains(&found),
                Size::Any(_) => found > 0,
            });
        if fits {
            return Ok(tensor);
        }
        Err(self.mismatch(name, &describe(shape), &tensor))
    }

    /// The error for a tensor that should be `expected`.
    pub(super) fn mismatch(
        &self,
        name: &str,
        expected: &str,
        found: &HostTensor,
    ) -> CheckpointError {
        CheckpointError::Shape {
            path: self.file.path().to_owned(),
            tensor: name.to_owned(),
            expected: expected.to_owned(),
            found: found.shape().to_vec(),
        }
    }

    /// How many of `name(0)`, `name(1)`, .. are there without a gap.
    pub(super) fn count(&self, name: impl Fn(usize) -> String) -> usize {
        (0..).take_while(|&index| self.file.contains(&name(index))).count()
    }
}

fn describe(shape: &[Size]) -> String {
    let sizes: Vec<String> = shape
        .iter()
        .map(|size| match size {
            Size::Is(value) => value.to_string(),
            Size::Between(least, most) => format!("{least} to {most}"),
            Size::Any(name) => (*name).to_owned(),
        })
        .collect();
    format!("[{}]", sizes.join(", "))
}
