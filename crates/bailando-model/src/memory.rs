//! What the motion GPT remembers of dances side by side, in memory that is allocated once.

use std::ops::Range;

use ort::value::{DynValue, TensorRef};

use super::{ModelError, session::one_line};

/// Streams of tokens: music, upper, lower.
pub(super) const STREAMS: usize = 3;
/// Kinds of what is remembered of a token: its key and its value.
const KINDS: usize = 2;

/// Keys and values of the latest steps of several dances, a row each.
///
/// Every row has the same slots, filled from the first on; the mask hides the others. So a
/// dance is computed in the same way whatever is beside it.
#[derive(Debug)]
pub struct GptMemory {
    /// Keys and values of every layer, `[rows, heads, tokens, head size]`.
    layers: Vec<[Vec<f32>; KINDS]>,
    /// Steps that a row holds.
    filled: Vec<usize>,
    shape: RowShape,
}

/// Shape of a row in a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RowShape {
    pub(super) heads: usize,
    /// Steps that fit.
    pub(super) steps: usize,
    pub(super) head_size: usize,
}

impl RowShape {
    pub(super) fn tokens(self) -> usize {
        STREAMS * self.steps
    }

    fn size(self) -> usize {
        self.heads * self.tokens() * self.head_size
    }
}

impl GptMemory {
    /// Rows that remember nothing. The operating system gives memory to those that are used.
    pub(super) fn new(rows: usize, layers: usize, shape: RowShape) -> Self {
        let numbers = || vec![0.0; rows * shape.size()];
        Self {
            layers: (0..layers).map(|_| [numbers(), numbers()]).collect(),
            filled: vec![0; rows],
            shape,
        }
    }

    /// Dances that fit side by side.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.filled.len()
    }

    /// Steps that a row remembers.
    #[must_use]
    pub fn steps(&self, row: usize) -> usize {
        self.filled.get(row).copied().unwrap_or(0)
    }

    /// Makes a row remember nothing.
    pub fn forget(&mut self, row: usize) {
        if let Some(steps) = self.filled.get_mut(row) {
            *steps = 0;
        }
    }

    /// Makes rows from `to` on remember what those in `from` do; all of them must exist.
    pub fn copy(&mut self, from: Range<usize>, to: usize) {
        if from.end > self.rows() || to + from.len() > self.rows() || from.is_empty() {
            return;
        }
        let size = self.shape.size();
        for numbers in self.layers.iter_mut().flatten() {
            numbers.copy_within(from.start * size..from.end * size, to * size);
        }
        self.filled.copy_within(from, to);
    }

    pub(super) fn shape(&self) -> RowShape {
        self.shape
    }

    /// Keys and values of the first rows in every layer, without a copy.
    pub(super) fn first(
        &self,
        graph: &'static str,
        rows: usize,
    ) -> Result<Vec<[TensorRef<'_, f32>; KINDS]>, ModelError> {
        self.layers
            .iter()
            .map(|[keys, values]| {
                Ok([
                    self.view(graph, keys, rows)?,
                    self.view(graph, values, rows)?,
                ])
            })
            .collect()
    }

    fn view<'numbers>(
        &self,
        graph: &'static str,
        numbers: &'numbers [f32],
        rows: usize,
    ) -> Result<TensorRef<'numbers, f32>, ModelError> {
        let RowShape {
            heads, head_size, ..
        } = self.shape;
        let shape = [rows, heads, self.shape.tokens(), head_size];
        let part = numbers.get(..rows * self.shape.size()).unwrap_or_default();
        TensorRef::from_array_view((shape, part)).map_err(|e| ModelError::Run {
            graph,
            problem: one_line(&e),
        })
    }

    /// Appends the newest steps of a run to its rows, the first on. `present` has keys and values of
    /// every layer as the graph gave them, `[runs, heads, tokens, head size]`: the newest tokens are the last, a
    /// stream behind another. What no longer fits is not kept: a window that is full moves next.
    pub(super) fn append(
        &mut self,
        graph: &'static str,
        rows: Range<usize>,
        steps: usize,
        present: &[[DynValue; KINDS]],
    ) -> Result<(), ModelError> {
        let wrong = |problem: String| ModelError::Run { graph, problem };
        let shape = self.shape;
        for (numbers, values) in self.layers.iter_mut().zip(present) {
            for (numbers, value) in numbers.iter_mut().zip(values) {
                let (_, found) = value
                    .try_extract_tensor::<f32>()
                    .map_err(|e| wrong(one_line(&e)))?;
                let of_head = found.len() / (rows.len() * shape.heads).max(1);
                let newest = STREAMS * steps * shape.head_size;
                if of_head < newest {
                    return Err(wrong(format!("keys or values end after {of_head} numbers")));
                }
                let heads = found.chunks_exact(of_head.max(1));
                let places = rows
                    .clone()
                    .flat_map(|row| (0..shape.heads).map(move |head| (row, head)));
                for (head_numbers, (row, head)) in heads.zip(places) {
                    let filled = self.filled.get(row).copied().unwrap_or(0);
                    if filled + steps > shape.steps {
                        continue;
                    }
                    let first = row * shape.size()
                        + (head * shape.tokens() + STREAMS * filled) * shape.head_size;
                    let target = numbers.get_mut(first..first + newest);
                    let source = head_numbers.get(of_head - newest..);
                    if let (Some(target), Some(source)) = (target, source) {
                        target.copy_from_slice(source);
                    }
                }
            }
        }
        for filled in self.filled.get_mut(rows).unwrap_or_default() {
            if *filled + steps <= shape.steps {
                *filled += steps;
            }
        }
        Ok(())
    }
}
