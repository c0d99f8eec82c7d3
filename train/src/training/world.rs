//! How decoded joints move in the world, where the root carries them.

use burn_tensor::Tensor;

use crate::{data::FPS, nn::Kernels};

/// Steps of a window whose mean kinetic energy is compared: a second.
const WINDOW: usize = FPS;
/// Added to squares of speeds, so that their root has a derivative at rest, (metres a frame)^2.
const REST: f64 = 1e-10;

/// Computes how far joints move from frame to frame in the world, `[batch, frames - 1, joints, 3]`
/// metres, of decoded joints `[batch, frames, 3 * joints]` and the root's velocity, and turn in the
/// dancer's frame, `[batch, frames, 3 or 4]`.
pub(super) fn world_steps<B: Kernels>(joints: &Tensor<B, 3>, root: &Tensor<B, 3>) -> Tensor<B, 4> {
    let [batch, frames, columns] = joints.dims();
    let joints = joints.clone().reshape([batch, frames, columns / 3, 3]);
    let now = joints.clone().narrow(1, 0, frames - 1);
    let next = joints.narrow(1, 1, frames - 1);
    let [_, _, root_columns] = root.dims();
    let root = root.clone().narrow(1, 0, frames - 1).unsqueeze_dim::<4>(2);
    let next = if root_columns > 3 { turned(next, root.clone().narrow(3, 3, 1)) } else { next };
    root.narrow(3, 0, 3) + next - now
}

/// Turns vectors about +y: +z goes towards +x.
fn turned<B: Kernels>(vectors: Tensor<B, 4>, angle: Tensor<B, 4>) -> Tensor<B, 4> {
    let (sin, cos) = (angle.clone().sin(), angle.cos());
    let [x, y, z] = [0, 1, 2].map(|axis| vectors.clone().narrow(3, axis, 1));
    let across = x.clone() * cos.clone() + z.clone() * sin.clone();
    Tensor::cat(vec![across, y, z * cos - x * sin], 3)
}

/// Computes the lengths of vectors along the last dimension, which becomes 1.
pub(super) fn lengths<B: Kernels, const D: usize>(vectors: Tensor<B, D>) -> Tensor<B, D> {
    vectors.square().sum_dim(D - 1).add_scalar(REST).sqrt()
}

/// Computes the mean error of joints' root-mean-square speeds over each second, of the steps of
/// decoded and recorded motion, across the floor and up or down, metres a frame: zero where decoded
/// motion has the kinetic energy of the recording, whenever in that second it is spent.
///
/// Squared errors of places make motion slower than any recording where the same codes stand for
/// several; this says nothing of where joints go.
pub(super) fn energy_error<B: Kernels>(steps: [Tensor<B, 4>; 2]) -> Tensor<B, 1> {
    let [found, recorded] = steps.map(mean_speeds);
    (found - recorded).abs().mean()
}

/// Returns root-mean-square speeds across the floor and up, `[batch, seconds, joints, 2]`, of steps
/// `[batch, frames, joints, 3]`; of all frames where they are fewer than a second's.
fn mean_speeds<B: Kernels>(steps: Tensor<B, 4>) -> Tensor<B, 4> {
    let [batch, frames, joints, _] = steps.dims();
    let window = WINDOW.min(frames);
    let windows = frames / window;
    let squares = steps.narrow(1, 0, windows * window).square();
    let [x, y, z] = [0, 1, 2].map(|axis| squares.clone().narrow(3, axis, 1));
    let squares = Tensor::cat(vec![x + z, y], 3).reshape([batch, windows, window, joints * 2]);
    let means = squares.mean_dim(2).reshape([batch, windows, joints, 2]);
    means.add_scalar(REST).sqrt()
}

#[cfg(test)]
mod tests {
    use burn_flex::{Flex, FlexDevice};
    use burn_tensor::TensorData;

    use super::*;
    use crate::nn::values;

    const FRAMES: usize = 2 * WINDOW + 1;

    /// Steps of one joint, metres a frame.
    fn steps(step: impl Fn(usize) -> [f32; 3]) -> Tensor<Flex, 4> {
        let values: Vec<f32> = (0..FRAMES).flat_map(step).collect();
        Tensor::from_data(TensorData::new(values, [1, FRAMES, 1, 3]), &FlexDevice)
    }

    #[test]
    fn energy_is_the_mean_square_of_a_second_across_the_floor_and_up() {
        let speeds = values(&mean_speeds(steps(|frame| {
            let second = if frame < WINDOW { 1.0 } else { 2.0 };
            [0.03 * second, 0.05 * f32::from(u8::from(frame % 2 == 0)), -0.04 * second]
        })));
        let up = 0.05 * 0.5_f32.sqrt();
        for (found, wanted) in speeds.iter().zip([0.05, up, 0.1, up]) {
            assert!((found - wanted).abs() < 1e-4, "{speeds:?}");
        }
        assert_eq!(speeds.len(), 4);
    }

    #[test]
    fn a_motion_of_the_same_energy_has_no_error_whenever_it_is_spent() {
        let early = |frame: usize| [f32::from(u8::from(frame % WINDOW < 10)) * 0.1, 0.0, 0.0];
        let late = |frame: usize| [0.0, 0.0, f32::from(u8::from(frame % WINDOW >= 50)) * -0.1];
        let error = values(&energy_error([steps(early), steps(late)]))[0];
        assert!(error < 1e-6, "{error}");
        // Half as quick: half of the root-mean-square speed is missing, across the floor alone.
        let slow = |frame: usize| early(frame).map(|step| step / 2.0);
        let error = values(&energy_error([steps(slow), steps(early)]))[0];
        let wanted = 0.05 * (10.0 / WINDOW as f32).sqrt() / 2.0;
        assert!((error - wanted).abs() < 1e-5, "{error} {wanted}");
    }
}
