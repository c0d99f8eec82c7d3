//! Tensors of a checkpoint by name, with their shapes checked.

use std::path::Path;

use crate::{
    HostTensor,
    checkpoint::{CheckpointError, TorchCheckpoint},
};

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

/// Takes checked tensors out of a checkpoint.
pub(super) struct Source<'a> {
    checkpoint: &'a mut TorchCheckpoint,
}

impl<'a> Source<'a> {
    pub(super) fn new(checkpoint: &'a mut TorchCheckpoint) -> Self {
        Self { checkpoint }
    }

    pub(super) fn path(&self) -> &Path {
        self.checkpoint.path()
    }

    /// Takes the tensor `name`, whose shape must match `shape`.
    pub(super) fn take(
        &mut self,
        name: &str,
        shape: &[Size],
    ) -> Result<HostTensor, CheckpointError> {
        let tensor = self.checkpoint.tensor(name)?;
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
            path: self.checkpoint.path().to_owned(),
            tensor: name.to_owned(),
            expected: expected.to_owned(),
            found: found.shape().to_vec(),
        }
    }

    /// How many of `name(0)`, `name(1)`, .. are there without a gap.
    pub(super) fn count(&self, name: impl Fn(usize) -> String) -> usize {
        (0..).take_while(|&index| self.checkpoint.contains(&name(index))).count()
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
