//! Stage `velocity`: the root's decoder on frozen codes of the lower half.

use burn_tensor::{Tensor as Device, TensorData, backend::AutodiffBackend};

use super::{
    Config, MotionSet, Stage, TrainError,
    keep::settings,
    runner::{Losses, Plan, Work},
    saved::Saved,
    vqvae::{Halves, Trained, differences, half_crops},
    windows::Windows,
};
use crate::nn::{DecoderNet, Parameters, Store};

/// The root's decoder and the weights it starts from.
pub(super) fn root(config: &Config) -> (DecoderNet, Store) {
    let mut store = Store::default();
    let net = DecoderNet::new("root", &Halves::random(config).weights.root, &mut store);
    (net, store)
}

pub(super) struct VelocityWork<'a, A: AutodiffBackend> {
    config: &'a Config,
    set: &'a MotionSet,
    windows: Windows,
    net: DecoderNet,
    frozen: Trained<A::InnerBackend>,
    device: A::Device,
}

impl<'a, A: AutodiffBackend> VelocityWork<'a, A> {
    pub(super) fn new(
        config: &'a Config,
        set: &'a MotionSet,
        device: &A::Device,
    ) -> Result<(Plan<'a>, Self), TrainError> {
        let stage = &config.velocity;
        let frozen = Trained::read(config, device)?;
        let (net, store) = root(config);
        let lengths = set.training().map(|piece| piece.motion.nrows());
        let windows = Windows::new(lengths, stage.frames, stage.stride, config.run.seed ^ 1);
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
            settings: settings(config, Stage::Velocity)?,
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
}

impl<A: AutodiffBackend> Work<A> for VelocityWork<'_, A> {
    const COLUMNS: &'static [&'static str] = &["loss", "velocity", "difference"];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let stage = &self.config.velocity;
        let windows = self.windows.batch(step, stage.training.batch);
        let lower = half_crops(self.set, &windows, stage.frames, 1, &self.device);
        let [_, codebook] = &self.frozen.codebooks;
        let [_, half] = &self.frozen.halves.nets;
        let codes = half.encode(&self.frozen.parameters, codebook, lower);
        let entries = codebook.lookup(codes);
        let [rows, channels] = entries.dims();
        let entries = entries.reshape([windows.len(), rows / windows.len(), channels]);

        let pieces: Vec<_> = self.set.training().collect();
        let mut values = Vec::with_capacity(windows.len() * stage.frames * 3);
        for &(piece, start) in &windows {
            for frame in start..start + stage.frames {
                values.extend((0..3).map(|axis| pieces[piece].motion[[frame, axis]]));
            }
        }
        let shape = [windows.len(), stage.frames, 3];
        let target = Device::<A, 3>::from_data(TensorData::new(values, shape), &self.device);
        let found = self.net.forward(parameters, Device::from_inner(entries));
        let [velocity, difference, _] = differences(found - target);
        let loss = velocity.clone() + difference.clone().mul_scalar(stage.difference_weight);
        let metrics = [loss.clone(), velocity, difference].map(Device::inner);
        Losses {
            loss,
            metrics: metrics.into(),
        }
    }

    fn save(&self, _saved: &mut Saved) {}

    fn restore(&mut self, _saved: &Saved) -> Result<(), String> {
        Ok(())
    }
}
