//! Stage `velocity`: the root's decoder on frozen codes of the lower half.

use burn_tensor::{Tensor as Device, TensorData, backend::Backend};

use super::{
    Config, MotionSet, Stage, TrainError,
    input::MotionPiece,
    runner::{Losses, Plan, Work},
    saved::Saved,
    vqvae::{Halves, Trained, differences, half_crops, test_means},
    windows::Windows,
};
use crate::{
    data::{CropPlan, Draw},
    nn::{DecoderNet, Parameters, Store, Trainable},
};

/// The root's decoder and the weights it starts from.
pub(super) fn root(config: &Config) -> (DecoderNet, Store) {
    let mut store = Store::default();
    let net = DecoderNet::new("root", &Halves::random(config).weights.root, &mut store);
    (net, store)
}

pub(super) struct VelocityWork<'a, A: Trainable> {
    config: &'a Config,
    set: &'a MotionSet,
    windows: Windows,
    net: DecoderNet,
    frozen: Trained<A::InnerBackend>,
    device: A::Device,
}

impl<'a, A: Trainable> VelocityWork<'a, A> {
    pub(super) fn new(
        config: &'a Config,
        set: &'a MotionSet,
        device: &A::Device,
    ) -> Result<(Plan<'a>, Self), TrainError> {
        let stage = &config.velocity;
        let frozen = Trained::read(config, device)?;
        let (net, store) = root(config);
        let crops = CropPlan {
            frames: stage.frames,
            stride: stage.stride,
            mirror: config.data.mirror,
        };
        let choices = set.training.motion_choices(config.data.phases);
        let windows = Windows::new(crops, choices, config.run.seed ^ 1);
        if windows.len() == 0 {
            return Err(TrainError::TooShort {
                length: stage.frames,
                unit: "frames",
            });
        }
        let plan = Plan {
            name: "velocity",
            run: &config.run,
            training: &stage.training,
            settings: set.settings(config, Stage::Velocity)?,
            store,
            windows: windows.len(),
        };
        let work = Self {
            config,
            set,
            windows,
            net,
            frozen,
            device: device.clone(),
        };
        Ok((plan, work))
    }

    /// Entries of the lower codes of some crops, and the velocity that belongs to them.
    fn examples(
        &self,
        pieces: &[MotionPiece],
        windows: &[Draw],
    ) -> [Device<A::InnerBackend, 3>; 2] {
        let frames = self.config.velocity.frames;
        let halves = &self.frozen.halves;
        let ([_, columns], [_, half]) = (&halves.columns, &halves.nets);
        let lower = half_crops(pieces, windows, frames, columns, &self.device);
        let [_, codebook] = &self.frozen.codebooks;
        let mut entries = half.encoder.forward(&self.frozen.parameters, lower);
        if !self.config.ablation.continuous {
            let [windows, codes, channels] = entries.dims();
            let nearest = codebook.nearest(entries.reshape([windows * codes, channels]));
            entries = codebook.lookup(nearest).reshape([windows, codes, channels]);
        }

        let columns = self.config.data.root_columns();
        let mut values = Vec::with_capacity(windows.len() * frames * columns.len());
        for window in windows {
            let piece = &pieces[window.dance];
            for frame in window.frames(frames) {
                let row = columns.iter();
                values.extend(row.map(|&column| piece.value(frame, column, window.mirrored)));
            }
        }
        let shape = [windows.len(), frames, columns.len()];
        let target = Device::from_data(TensorData::new(values, shape), &self.device);
        [entries, target]
    }

    /// Loss, error of the velocity and of its differences.
    fn losses<B: Backend>(&self, error: Device<B, 3>) -> [Device<B, 1>; 3] {
        let [velocity, difference, _] = differences(error);
        let weighted = difference
            .clone()
            .mul_scalar(self.config.velocity.difference_weight);
        [velocity.clone() + weighted, velocity, difference]
    }
}

impl<A: Trainable> Work<A> for VelocityWork<'_, A> {
    const COLUMNS: &'static [&'static str] = &["loss", "velocity", "difference"];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let stage = &self.config.velocity;
        let windows = self.windows.batch(step, stage.training.batch);
        let [entries, target] = self.examples(self.set.training.pieces(), &windows);
        let found = self.net.forward(parameters, Device::from_inner(entries));
        let losses = self.losses(found - Device::from_inner(target));
        let [loss, ..] = losses.clone();
        Losses {
            loss,
            metrics: losses.map(Device::inner).into(),
        }
    }

    const TEST_COLUMNS: &'static [&'static str] = &["test_loss"];

    fn test(&self, parameters: &Parameters<A::InnerBackend>) -> Option<Vec<f32>> {
        let stage = &self.config.velocity;
        let test = self.set.test.as_ref()?;
        let crops = test.crops(stage.frames);
        test_means(&crops, stage.training.batch, |windows| {
            let [entries, target] = self.examples(test.pieces(), windows);
            let found = self.net.forward(parameters, entries);
            let [loss, ..] = self.losses(found - target);
            [loss]
        })
    }

    fn save(&self, _saved: &mut Saved) {}

    fn restore(&mut self, _saved: &Saved) -> Result<(), String> {
        Ok(())
    }
}
