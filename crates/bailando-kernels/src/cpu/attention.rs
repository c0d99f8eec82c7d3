//! Attention: one thread computes all heads of a piece.

use burn_flex::Flex;
use burn_tensor::Tensor;
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, Slice, linalg::general_mat_mul};
use rayon::prelude::*;

use super::{
    elementwise::exp,
    memory::{host, tensor, values},
};
use crate::{AttentionInputs, Queries};

/// One piece, `[length, channels]` each, and what its heads have in common.
struct Piece<'a> {
    heads: usize,
    query: ArrayView2<'a, f32>,
    key: ArrayView2<'a, f32>,
    value: ArrayView2<'a, f32>,
    forbidden: &'a [bool],
    /// Factors of the shares, `[heads, length, length]`, where some are dropped.
    kept: Option<&'a [f32]>,
}

impl Piece<'_> {
    fn columns(&self, head: usize) -> Slice {
        let size = self.query.ncols() / self.heads.max(1);
        Slice::from(head * size..(head + 1) * size)
    }

    fn scale(&self) -> f32 {
        let size = self.query.ncols() / self.heads.max(1);
        1.0 / (size as f32).sqrt()
    }

    fn kept(&self, head: usize) -> Option<&[f32]> {
        let length = self.query.nrows() * self.query.nrows();
        self.kept?.get(head * length..(head + 1) * length)
    }

    /// Shares of the values in each result, `[length, length]`, before any are dropped.
    #[expect(clippy::expect_used, reason = "a fresh array is contiguous")]
    fn shares(&self, head: usize) -> Array2<f32> {
        let length = self.query.nrows();
        let query = self.query.slice_axis(Axis(1), self.columns(head));
        let key = self.key.slice_axis(Axis(1), self.columns(head));
        let mut shares = Array2::zeros((length, length));
        general_mat_mul(self.scale(), &query, &key.t(), 0.0, &mut shares);
        let rows =
            shares.as_slice_mut().expect("fresh zeros are contiguous").chunks_mut(length.max(1));
        for (row, forbidden) in rows.zip(self.forbidden.chunks(length.max(1))) {
            soften(row, forbidden);
        }
        shares
    }

    fn dropped(&self, head: usize, shares: &Array2<f32>) -> Array2<f32> {
        let mut dropped = shares.clone();
        self.drop(head, &mut dropped);
        dropped
    }

    fn drop(&self, head: usize, shares: &mut Array2<f32>) {
        let kept = self.kept(head).into_iter().flatten();
        for (share, kept) in shares.iter_mut().zip(kept) {
            *share *= kept;
        }
    }

    fn forward(&self, mut output: ArrayViewMut2<'_, f32>) {
        for head in 0..self.heads {
            let mut shares = self.shares(head);
            self.drop(head, &mut shares);
            let value = self.value.slice_axis(Axis(1), self.columns(head));
            let mut output = output.slice_axis_mut(Axis(1), self.columns(head));
            general_mat_mul(1.0, &shares, &value, 0.0, &mut output);
        }
    }

    fn backward(&self, outer: ArrayView2<'_, f32>, by: [ArrayViewMut2<'_, f32>; 3]) {
        let [mut by_query, mut by_key, mut by_value] = by;
        for head in 0..self.heads {
            let columns = self.columns(head);
            let shares = self.shares(head);
            let outer = outer.slice_axis(Axis(1), columns);
            let value = self.value.slice_axis(Axis(1), columns);
            let mut by_value = by_value.slice_axis_mut(Axis(1), columns);
            let dropped = self.dropped(head, &shares);
            general_mat_mul(1.0, &dropped.t(), &outer, 0.0, &mut by_value);
            let mut change = outer.dot(&value.t());
            self.drop(head, &mut change);
            for (mut change, shares) in change.outer_iter_mut().zip(shares.outer_iter()) {
                let along: f32 = change.iter().zip(&shares).map(|(a, b)| a * b).sum();
                for (change, share) in change.iter_mut().zip(&shares) {
                    *change = share * (*change - along);
                }
            }
            let query = self.query.slice_axis(Axis(1), columns);
            let key = self.key.slice_axis(Axis(1), columns);
            let mut by_query = by_query.slice_axis_mut(Axis(1), columns);
            general_mat_mul(self.scale(), &change, &key, 0.0, &mut by_query);
            let mut by_key = by_key.slice_axis_mut(Axis(1), columns);
            general_mat_mul(self.scale(), &change.t(), &query, 0.0, &mut by_key);
        }
    }
}

/// Scores to shares that sum to 1, those of forbidden places 0.
fn soften(row: &mut [f32], forbidden: &[bool]) {
    for (score, &forbidden) in row.iter_mut().zip(forbidden) {
        *score = if forbidden { f32::NEG_INFINITY } else { *score };
    }
    let highest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    for score in row.iter_mut() {
        *score = exp(*score - highest);
    }
    let whole = 1.0 / row.iter().sum::<f32>();
    for score in row.iter_mut() {
        *score *= whole;
    }
}

/// All pieces of a batch.
struct Batch {
    heads: usize,
    length: usize,
    channels: usize,
    parts: [burn_flex::FlexTensor; 3],
    forbidden: Vec<bool>,
    kept: Option<burn_flex::FlexTensor>,
}

impl Batch {
    fn new(AttentionInputs { heads, queries, forbidden, kept }: AttentionInputs<Flex>) -> Self {
        let [_, length, channels] = queries.query.dims();
        Self {
            heads,
            length,
            channels,
            parts: [queries.query, queries.key, queries.value].map(host),
            forbidden: forbidden.into_data().iter::<bool>().collect(),
            kept: kept.map(host),
        }
    }

    fn size(&self) -> usize {
        self.length * self.channels
    }

    fn piece(&self, index: usize) -> Option<Piece<'_>> {
        let view = |part: usize| {
            let values = values(&self.parts[part]);
            let values = values.get(index * self.size()..(index + 1) * self.size())?;
            ArrayView2::from_shape((self.length, self.channels), values).ok()
        };
        let factors = self.heads * self.length * self.length;
        Some(Piece {
            heads: self.heads,
            query: view(0)?,
            key: view(1)?,
            value: view(2)?,
            forbidden: &self.forbidden,
            kept: match &self.kept {
                Some(kept) => Some(values(kept).get(index * factors..(index + 1) * factors)?),
                None => None,
            },
        })
    }
}

pub(super) fn attend(inputs: AttentionInputs<Flex>) -> Tensor<Flex, 3> {
    let shape = inputs.queries.query.dims();
    let batch = Batch::new(inputs);
    let mut output = vec![0.0; shape.iter().product()];
    let pieces = output.par_chunks_mut(batch.size().max(1)).enumerate();
    pieces.for_each(|(index, output)| {
        let output = ArrayViewMut2::from_shape((batch.length, batch.channels), output);
        if let (Some(piece), Ok(output)) = (batch.piece(index), output) {
            piece.forward(output);
        }
    });
    tensor(output, shape)
}

pub(super) fn attend_backward(
    inputs: AttentionInputs<Flex>,
    outer: Tensor<Flex, 3>,
) -> Queries<Flex> {
    let shape = inputs.queries.query.dims();
    let batch = Batch::new(inputs);
    let outer = host(outer);
    let [mut query, mut key, mut value] = [(); 3].map(|()| vec![0.0; shape.iter().product()]);
    let size = batch.size().max(1);
    query
        .par_chunks_mut(size)
        .zip(key.par_chunks_mut(size))
        .zip(value.par_chunks_mut(size))
        .zip(values(&outer).par_chunks(size))
        .enumerate()
        .for_each(|(index, (((query, key), value), outer))| {
            let shape = (batch.length, batch.channels);
            let by = [query, key, value].map(|part| ArrayViewMut2::from_shape(shape, part));
            let outer = ArrayView2::from_shape(shape, outer);
            if let (Some(piece), [Ok(query), Ok(key), Ok(value)], Ok(outer)) =
                (batch.piece(index), by, outer)
            {
                piece.backward(outer, [query, key, value]);
            }
        });
    Queries { query: tensor(query, shape), key: tensor(key, shape), value: tensor(value, shape) }
}
