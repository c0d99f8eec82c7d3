//! Values on their way between the host and a device.

use burn_tensor::{Int, Tensor, TensorData, backend::Backend};

/// Returns the values of a tensor in row-major order.
pub(crate) fn values<B: Backend, const D: usize>(tensor: &Tensor<B, D>) -> Vec<f32> {
    tensor.to_data().iter::<f32>().collect()
}

/// Copies numbers in row-major order to a device.
pub(crate) fn numbers<B: Backend, const D: usize>(
    values: Vec<f32>,
    shape: [usize; D],
    device: &B::Device,
) -> Tensor<B, D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// Copies codes in row-major order to a device.
pub(crate) fn codes<B: Backend, const D: usize>(
    codes: impl IntoIterator<Item = i32>,
    shape: [usize; D],
    device: &B::Device,
) -> Tensor<B, D, Int> {
    let codes: Vec<i32> = codes.into_iter().collect();
    Tensor::from_data(TensorData::new(codes, shape), device)
}

/// Gathers the rows of windows, `[windows, steps, columns]`: `row(window, step)` gives one row.
pub(crate) fn gathered<B: Backend, W, R: IntoIterator<Item = f32>>(
    windows: &[W],
    [steps, columns]: [usize; 2],
    row: impl Fn(&W, usize) -> R,
    device: &B::Device,
) -> Tensor<B, 3> {
    let mut rows = Vec::with_capacity(windows.len() * steps * columns);
    for window in windows {
        (0..steps).for_each(|step| rows.extend(row(window, step)));
    }
    numbers(rows, [windows.len(), steps, columns], device)
}
