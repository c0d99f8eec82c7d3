//! How large a rig may be.

use super::refusal::{problem, short};
use crate::error::FormatError;

/// Longest name of a bone in bytes.
const LONGEST_NAME: usize = 1000;

/// How large a rig may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RigLimits {
    /// Most bytes of the file.
    pub bytes: usize,
    /// Most bones or nodes.
    pub bones: usize,
}

impl Default for RigLimits {
    fn default() -> Self {
        Self { bytes: 50_000_000, bones: 10_000 }
    }
}

impl RigLimits {
    /// Refuses more bones than are allowed.
    pub(super) fn check_bones(&self, bones: usize) -> Result<(), FormatError> {
        match bones > self.bones {
            true => problem(format!("it has more than {} bones or nodes", self.bones)),
            false => Ok(()),
        }
    }
}

/// Refuses a name that is longer than any of a bone: each is kept more than once.
pub(super) fn check_name(name: &str) -> Result<(), FormatError> {
    match name.len() > LONGEST_NAME {
        true => problem(format!("`{}` is a name of {} bytes", short(name), name.len())),
        false => Ok(()),
    }
}
