//! Keys and values of sequences side by side, in memory that is allocated once.

use std::ops::Range;

use ort::value::TensorRef;

use super::{ModelError, error::one_line};

/// Streams of tokens: music, upper, lower.
pub(super) const STREAMS: usize = 3;
/// Tensors of a layer: keys and values.
const KINDS: usize = 2;

/// Keys and values of the latest steps of several sequences, a row each.
///
/// Every row has the same slots, filled from the first on; the mask hides the others. So a
/// sequence is computed in the same way whatever runs beside it.
#[derive(Debug)]
pub struct KvCache {
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

impl KvCache {
    /// Empty rows. The operating system gives memory to those that are used.
    pub(super) fn new(rows: usize, layers: usize, shape: RowShape) -> Self {
        let numbers = || vec![0.0; rows * shape.size()];
        Self {
            layers: (0..layers).map(|_| [numbers(), numbers()]).collect(),
            filled: vec![0; rows],
            shape,
        }
    }

    /// Sequences that fit side by side.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.filled.len()
    }

    /// Steps that a row holds.
    ///
    /// # Panics
    /// For a row that does not exist.
    #[must_use]
    pub fn steps(&self, row: usize) -> usize {
        self.filled[row]
    }

    /// Empties a row.
    ///
    /// # Panics
    /// For a row that does not exist.
    pub fn clear(&mut self, row: usize) {
        self.filled[row] = 0;
    }

    /// Copies rows to those from `to` on.
    ///
    /// # Panics
    /// For rows that do not exist.
    pub fn copy(&mut self, from: Range<usize>, to: usize) {
        let rows = self.rows();
        assert!(
            from.start <= from.end && from.end <= rows && to + from.len() <= rows,
            "rows {from:?} cannot be copied to row {to} of a cache of {rows}"
        );
        let size = self.shape.size();
        self.filled.copy_within(from.clone(), to);
        for numbers in self.layers.iter_mut().flatten() {
            numbers.copy_within(from.start * size..from.end * size, to * size);
        }
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
                Ok([self.view(graph, keys, rows)?, self.view(graph, values, rows)?])
            })
            .collect()
    }

    fn view<'numbers>(
        &self,
        graph: &'static str,
        numbers: &'numbers [f32],
        rows: usize,
    ) -> Result<TensorRef<'numbers, f32>, ModelError> {
        let RowShape { heads, head_size, .. } = self.shape;
        let shape = [rows, heads, self.shape.tokens(), head_size];
        let part = &numbers[..rows * self.shape.size()];
        TensorRef::from_array_view((shape, part))
            .map_err(|e| ModelError::Run { graph, problem: one_line(&e) })
    }

    /// Appends the newest `steps` of a run to `rows`. `present` has keys and values of every layer
    /// as the graph gives them, `[rows, heads, tokens, head size]`: the newest tokens come last.
    /// A full row stays as it is: its window moves before the next step, and is prefilled then.
    ///
    /// # Errors
    /// [`ModelError::Run`] for another number of layers, or for arrays of another size.
    pub(super) fn append(
        &mut self,
        graph: &'static str,
        rows: Range<usize>,
        steps: usize,
        present: &[[&[f32]; KINDS]],
    ) -> Result<(), ModelError> {
        let shape = self.shape;
        let newest = STREAMS * steps * shape.head_size;
        let heads = rows.len() * shape.heads;
        let fits = |found: &&[f32]| {
            found.len().is_multiple_of(heads.max(1)) && found.len() >= heads * newest
        };
        if present.len() != self.layers.len() || !present.iter().flatten().all(fits) {
            return Err(ModelError::Run {
                graph,
                problem: "its keys and values have other shapes than the manifest says".into(),
            });
        }
        for (numbers, found) in self.layers.iter_mut().flatten().zip(present.iter().flatten()) {
            let of_head = found.len() / heads.max(1);
            for (place, source) in found.chunks_exact(of_head.max(1)).enumerate() {
                let row = rows.start + place / shape.heads;
                let filled = self.filled[row];
                if filled + steps > shape.steps {
                    continue;
                }
                let head = row * shape.heads + place % shape.heads;
                let first = (head * shape.tokens() + STREAMS * filled) * shape.head_size;
                numbers[first..first + newest].copy_from_slice(&source[of_head - newest..]);
            }
        }
        for filled in &mut self.filled[rows] {
            if *filled + steps <= shape.steps {
                *filled += steps;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: RowShape = RowShape { heads: 2, steps: 3, head_size: 1 };

    /// Keys and values of one layer: `[rows, heads, tokens]` counted up from `first`.
    fn numbers(rows: usize, tokens: usize, first: f32) -> Vec<f32> {
        let count = rows * SHAPE.heads * tokens;
        (0..count).map(|number| first + number as f32).collect()
    }

    fn append(cache: &mut KvCache, rows: Range<usize>, steps: usize, present: &[f32]) {
        cache.append("graph", rows, steps, &[[present, present]]).unwrap();
    }

    /// Keys of a row's head, as far as they are filled.
    fn keys(cache: &KvCache, row: usize, head: usize) -> &[f32] {
        let first = (row * SHAPE.heads + head) * SHAPE.tokens();
        &cache.layers[0][0][first..first + STREAMS * cache.steps(row)]
    }

    #[test]
    fn the_newest_tokens_are_appended_to_their_rows() {
        let mut cache = KvCache::new(3, 1, SHAPE);
        append(&mut cache, 1..2, 1, &numbers(1, 3, 10.0));
        assert_eq!([0, 1, 2].map(|row| cache.steps(row)), [0, 1, 0]);
        assert_eq!(keys(&cache, 1, 1), [13.0, 14.0, 15.0]);
        // A run over all slots and one more step: only its last three tokens are new.
        append(&mut cache, 0..2, 1, &numbers(2, 12, 0.0));
        assert_eq!(keys(&cache, 0, 0), [9.0, 10.0, 11.0]);
        assert_eq!(keys(&cache, 1, 0), [10.0, 11.0, 12.0, 33.0, 34.0, 35.0]);
        assert_eq!([0, 1, 2].map(|row| cache.steps(row)), [1, 2, 0]);
    }

    #[test]
    fn rows_are_copied_and_cleared() {
        let mut cache = KvCache::new(3, 1, SHAPE);
        append(&mut cache, 1..2, 2, &numbers(1, 6, 1.0));
        cache.copy(1..3, 0);
        assert_eq!([0, 1, 2].map(|row| cache.steps(row)), [2, 0, 0]);
        assert_eq!(keys(&cache, 0, 1), [7.0, 8.0, 9.0, 10.0, 11.0, 12.0]);
        cache.clear(0);
        assert_eq!(cache.steps(0), 0);
    }

    #[test]
    fn a_full_row_stays_as_it_is() {
        let mut cache = KvCache::new(2, 1, SHAPE);
        append(&mut cache, 0..1, 3, &numbers(1, 9, 1.0));
        let before = keys(&cache, 0, 0).to_vec();
        append(&mut cache, 0..2, 1, &numbers(2, 3, 50.0));
        assert_eq!(keys(&cache, 0, 0), before);
        assert_eq!((cache.steps(0), cache.steps(1)), (3, 1));
    }

    #[test]
    fn other_shapes_are_an_error() {
        let mut cache = KvCache::new(2, 1, SHAPE);
        let mut wrong = |present: &[[&[f32]; KINDS]]| cache.append("graph", 0..2, 1, present);
        assert!(wrong(&[]).is_err());
        let (few, odd) = (numbers(2, 2, 0.0), [0.0; 13]);
        assert!(wrong(&[[&few, &few]]).is_err());
        assert!(wrong(&[[&odd, &odd]]).is_err());
    }

    #[test]
    #[should_panic(expected = "rows 0..2 cannot be copied to row 1 of a cache of 2")]
    fn a_copy_beyond_the_rows_is_a_defect() {
        KvCache::new(2, 1, SHAPE).copy(0..2, 1);
    }
}
