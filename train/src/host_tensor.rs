//! Dense float tensors on the host, as read from a checkpoint and written into a graph.

/// A dense tensor in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct HostTensor {
    shape: Vec<usize>,
    data: Vec<f32>,
}

/// The number of values does not fit the shape.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("the shape {shape:?} does not fit {values} values")]
pub struct ShapeMismatch {
    /// The shape asked for.
    pub shape: Vec<usize>,
    /// Number of values given.
    pub values: usize,
}

impl HostTensor {
    /// Makes a tensor of `shape` from `data` in row-major order.
    ///
    /// # Errors
    /// [`ShapeMismatch`] when the product of the shape is not the number of values.
    pub fn new(shape: Vec<usize>, data: Vec<f32>) -> Result<Self, ShapeMismatch> {
        if elements(&shape) == Some(data.len()) {
            Ok(Self { shape, data })
        } else {
            Err(ShapeMismatch { shape, values: data.len() })
        }
    }

    /// Makes a tensor whose value at flat index `i` is `value(i)`.
    pub(crate) fn from_fn(shape: Vec<usize>, value: impl FnMut(usize) -> f32) -> Self {
        let data = (0..shape.iter().product()).map(value).collect();
        Self { shape, data }
    }

    /// Returns the sizes of the dimensions.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Returns the size of one dimension; 0 for a missing dimension.
    #[must_use]
    pub fn dim(&self, axis: usize) -> usize {
        self.shape.get(axis).copied().unwrap_or(0)
    }

    /// Returns the values in row-major order.
    #[must_use]
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// Copies the rows `from..to` of the first dimension.
    pub(crate) fn rows(&self, from: usize, to: usize) -> Self {
        let row: usize = self.shape.iter().skip(1).product();
        let to = to.min(self.dim(0));
        let from = from.min(to);
        let mut shape = self.shape.clone();
        if let Some(first) = shape.first_mut() {
            *first = to - from;
        }
        let data = self.data.iter().skip(from * row).take((to - from) * row);
        Self { shape, data: data.copied().collect() }
    }

    /// Returns the `[columns, rows]` transpose of a `[rows, columns]` matrix.
    pub(crate) fn transposed(&self) -> Self {
        let (rows, columns) = (self.dim(0), self.dim(1));
        let mut data = Vec::with_capacity(self.data.len());
        for column in 0..columns {
            data.extend(self.data.iter().skip(column).step_by(columns.max(1)));
        }
        Self { shape: vec![columns, rows], data }
    }

    /// Joins tensors along the first dimension.
    pub(crate) fn stacked(parts: &[&Self]) -> Self {
        let mut shape = parts.first().map_or_else(Vec::new, |part| part.shape.clone());
        if let Some(first) = shape.first_mut() {
            *first = parts.iter().map(|part| part.dim(0)).sum();
        }
        let data = parts.iter().flat_map(|part| part.data.iter().copied()).collect();
        Self { shape, data }
    }
}

/// Returns the product of `shape`, unless it overflows.
pub(crate) fn elements(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1_usize, |product, &size| product.checked_mul(size))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counting(shape: &[usize]) -> HostTensor {
        HostTensor::from_fn(shape.to_vec(), |i| i as f32)
    }

    #[test]
    fn a_transpose_swaps_rows_and_columns() {
        let transposed = counting(&[2, 3]).transposed();
        assert_eq!(transposed.shape(), [3, 2]);
        assert_eq!(transposed.data(), [0.0, 3.0, 1.0, 4.0, 2.0, 5.0]);
    }

    #[test]
    fn rows_are_cut_and_stacked() {
        let tensor = counting(&[3, 2]);
        let last = tensor.rows(2, 9);
        assert_eq!(last.shape(), [1, 2]);
        assert_eq!(last.data(), [4.0, 5.0]);
        let stacked = HostTensor::stacked(&[&last, &tensor.rows(0, 1)]);
        assert_eq!(stacked.shape(), [2, 2]);
        assert_eq!(stacked.data(), [4.0, 5.0, 0.0, 1.0]);
    }

    #[test]
    fn a_shape_that_does_not_fit_is_refused() {
        assert!(HostTensor::new(vec![2, 2], vec![0.0; 3]).is_err());
        assert!(HostTensor::new(vec![usize::MAX, 2], vec![]).is_err());
        assert!(HostTensor::new(vec![3], vec![0.0; 3]).is_ok());
    }
}
