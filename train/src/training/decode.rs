//! Codes to dances, as the server decodes them but on the training device.

use bailando::motion::{Positions, integrate_root, to_world_frame};
use burn_tensor::{Int, Tensor as Device, TensorData};
use ndarray::Array2;

use super::{
    Config, Stage, TrainError, keep::read_kept, runner::WEIGHT, velocity::root, vqvae::Trained,
};
use crate::{
    nn::{DecoderNet, Kernels, Parameters, Store, values},
    weights::HALF_JOINTS,
};

/// Columns of positions.
const COLUMNS: usize = 72;

/// The decoders of a finished VQ-VAE and its root branch.
pub(super) struct DanceDecoder<B: Kernels> {
    trained: Trained<B>,
    root: DecoderNet,
    root_parameters: Parameters<B>,
    device: B::Device,
}

impl<B: Kernels> DanceDecoder<B> {
    pub(super) fn read(config: &Config, device: &B::Device) -> Result<Self, TrainError> {
        let (root, store) = trained_root(config)?;
        Ok(Self {
            trained: Trained::read(config, device)?,
            root,
            root_parameters: Parameters::from_store(&store, device),
            device: device.clone(),
        })
    }

    /// World positions of a whole piece from its upper and lower codes, 8 frames a code; none where
    /// a decoder gives what is no number.
    pub(super) fn positions(&self, codes: &[Vec<i32>; 2]) -> Option<Positions> {
        let [upper, lower] = [0, 1].map(|half| self.entries(codes, half));
        let parameters = &self.trained.parameters;
        let [upper_net, lower_net] = &self.trained.halves.nets;
        let upper = upper_net.decoder.forward(parameters, upper);
        let root = self.root.forward(&self.root_parameters, lower.clone());
        let lower = lower_net.decoder.forward(parameters, lower);
        let [_, frames, root_columns] = root.dims();
        // A fourth column is the dancer's turning: the motion is in the dancer's frame.
        let turning = root_columns - 3;
        let mut columns = Array2::zeros((frames, COLUMNS + turning));
        let (upper_joints, lower_joints) = HALF_JOINTS;
        copy_joints(&mut columns, &values(&upper), &upper_joints);
        copy_joints(&mut columns, &values(&lower), &lower_joints);
        let root = values(&root);
        for (mut row, root) in columns.outer_iter_mut().zip(root.chunks(root_columns)) {
            for (axis, &value) in root.iter().enumerate() {
                let column = if axis < 3 { axis } else { COLUMNS };
                row[column] = value;
            }
        }
        let world = if turning == 0 {
            columns
        } else {
            to_world_frame(columns.view()).ok()?
        };
        integrate_root(world.view(), [0.0; 3]).ok()
    }

    /// Codebook entries of one half, `[1, codes, channels]`.
    fn entries(&self, codes: &[Vec<i32>; 2], half: usize) -> Device<B, 3> {
        let codes = codes[half].clone();
        let shape = [codes.len()];
        let codes = Device::<B, 1, Int>::from_data(TensorData::new(codes, shape), &self.device);
        self.trained.codebooks[half].lookup(codes).unsqueeze_dim(0)
    }
}

/// The root branch as its finished stage left it.
pub(super) fn trained_root(config: &Config) -> Result<(DecoderNet, Store), TrainError> {
    let (root, store) = root(config);
    let (path, saved) = read_kept(config, Stage::Velocity)?;
    let store = saved.fill(WEIGHT, &store);
    let store = store.map_err(|message| TrainError::State { path, message })?;
    Ok((root, store))
}

/// Puts a half's columns where its joints belong.
fn copy_joints(columns: &mut Array2<f32>, half: &[f32], joints: &[usize]) {
    let rows = half.chunks(3 * joints.len());
    for (mut row, half) in columns.outer_iter_mut().zip(rows) {
        for (place, &joint) in joints.iter().enumerate() {
            for axis in 0..3 {
                row[3 * joint + axis] = half[3 * place + axis];
            }
        }
    }
}
