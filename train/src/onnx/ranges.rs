//! Ranges of the inputs of quantised matrices.

use std::collections::BTreeMap;

/// The least and the largest input of matrices, by the name of the matrix in the graph.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InputRanges(BTreeMap<String, [f32; 2]>);

impl InputRanges {
    /// Returns the range of the matrix `name`.
    pub(super) fn of(&self, name: &str) -> Option<[f32; 2]> {
        self.0.get(name).copied()
    }
}

impl FromIterator<(String, [f32; 2])> for InputRanges {
    fn from_iter<I: IntoIterator<Item = (String, [f32; 2])>>(ranges: I) -> Self {
        Self(ranges.into_iter().collect())
    }
}
