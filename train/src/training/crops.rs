//! Crops of motion on a device, and what the losses over them share.

use burn_tensor::{Tensor, backend::Backend};

use super::{
    config::{BalanceConfig, Config},
    error::TrainError,
    input::MotionSet,
    piece::MotionPiece,
    windows::Windows,
};
use crate::{
    data::{CropPlan, Draw},
    nn::{gathered, values},
};

/// Returns the windows of a stage that learns from motion alone.
///
/// # Errors
/// [`TrainError::TooShort`] where no motion is as long as a crop.
pub(super) fn motion_windows(
    config: &Config,
    set: &MotionSet,
    (frames, stride): (usize, usize),
    balance: &BalanceConfig,
    seed: u64,
) -> Result<Windows, TrainError> {
    let crops = CropPlan { frames, stride, mirror: config.data.mirror };
    let choices = set.training.motion_choices(config.data.phases);
    let windows = Windows::new(crops, choices, seed);
    let windows = windows.ok_or(TrainError::TooShort { length: frames, unit: "frames" })?;
    Ok(windows.balanced(balance, set.training.pieces()))
}

/// Gathers some columns of crops, `[batch, frames, columns]`; `None` is zero.
pub(super) fn motion_columns<B: Backend>(
    pieces: &[MotionPiece],
    windows: &[Draw],
    frames: usize,
    columns: &[Option<usize>],
    device: &B::Device,
) -> Tensor<B, 3> {
    let row = |window: &Draw, step: usize| {
        let (piece, mirrored) = (&pieces[window.dance], window.mirrored);
        let frame = window.frames(frames).start + step;
        let value = move |&column: &usize| piece.value(frame, column, mirrored);
        columns.iter().map(move |column| column.as_ref().map_or(0.0, value))
    };
    gathered(windows, [frames, columns.len()], row, device)
}

/// Returns the mean absolute value of an error, of its first and of its second difference in time.
pub(super) fn differences<B: Backend>(error: Tensor<B, 3>) -> [Tensor<B, 1>; 3] {
    let first = change(error.clone());
    let second = change(first.clone());
    [error, first, second].map(|tensor| tensor.abs().mean())
}

/// Returns the differences of neighbouring frames.
pub(super) fn change<B: Backend>(tensor: Tensor<B, 3>) -> Tensor<B, 3> {
    let [_, time, _] = tensor.dims();
    tensor.clone().narrow(1, 1, time - 1) - tensor.narrow(1, 0, time - 1)
}

/// Returns the means over all of `crops`, taken in batches; `None` where there are none.
pub(super) fn test_means<B: Backend, const N: usize>(
    crops: &[Draw],
    batch: usize,
    mut means: impl FnMut(&[Draw]) -> [Tensor<B, 1>; N],
) -> Option<Vec<f32>> {
    let mut sums = [0.0_f64; N];
    for some in crops.chunks(batch) {
        for (sum, mean) in sums.iter_mut().zip(means(some)) {
            let mean: f32 = values(&mean).into_iter().sum();
            *sum += f64::from(mean) * some.len() as f64;
        }
    }
    let mean = |sum| (sum / crops.len() as f64) as f32;
    (!crops.is_empty()).then(|| sums.map(mean).into())
}
