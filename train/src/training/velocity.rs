//! Stage `velocity`: the root's decoder on frozen codes of the lower half, and, if asked for, those of both
//! halves on: what codes mean no longer changes, so that decoders can follow them more closely.

use burn_tensor::{Tensor as Device, TensorData};

use super::{
    Config, MotionSet, Stage, TrainError,
    input::MotionPiece,
    keep::read_kept,
    runner::{Losses, Plan, WEIGHT, Work},
    saved::Saved,
    vqvae::{HALVES, Halves, Trained, differences, half_crops, test_means},
    windows::Windows,
};
use crate::{
    data::{CropPlan, Draw},
    nn::{DecoderNet, Kernels, Parameters, Store, Trainable},
};

/// Added to squares of speeds, so that their root has a derivative at rest, (metres a frame)^2.
const REST: f64 = 1e-10;

/// The decoders that the stage learns.
pub(super) struct Decoders {
    pub(super) root: DecoderNet,
    /// Of the upper and lower half, where they learn as well.
    pub(super) halves: Option<[DecoderNet; 2]>,
    pub(super) store: Store,
}

impl Decoders {
    /// Before the first step: the root's of random weights, those of the halves as they are.
    pub(super) fn new(config: &Config, halves: &Halves) -> Self {
        let mut store = Store::default();
        let root = DecoderNet::new("root", &halves.weights.root, &mut store);
        let mut half = |half: usize| {
            let weights = halves.nets[half].decoder.weights(&halves.store);
            DecoderNet::new(&format!("{}.decoder", HALVES[half]), &weights, &mut store)
        };
        Self {
            root,
            halves: config.velocity.pose_decoders.then(|| [half(0), half(1)]),
            store,
        }
    }

    /// As the finished stage left them.
    pub(super) fn trained(config: &Config) -> Result<Self, TrainError> {
        let decoders = Self::new(config, &Halves::random(config));
        let (path, saved) = read_kept(config, Stage::Velocity)?;
        let store = saved.fill(WEIGHT, &decoders.store);
        let store = store.map_err(|message| TrainError::State { path, message })?;
        Ok(Self { store, ..decoders })
    }
}

pub(super) struct VelocityWork<'a, A: Trainable> {
    config: &'a Config,
    set: &'a MotionSet,
    windows: Windows,
    root: DecoderNet,
    halves: Option<[DecoderNet; 2]>,
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
        let Decoders {
            root,
            halves,
            store,
        } = Decoders::new(config, &frozen.halves);
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
            root,
            halves,
            frozen,
            device: device.clone(),
        };
        Ok((plan, work))
    }

    /// Motion of one half, and the entries of its codes.
    fn half_examples(
        &self,
        half: usize,
        pieces: &[MotionPiece],
        windows: &[Draw],
    ) -> Examples<A::InnerBackend> {
        let frozen = &self.frozen;
        let frames = self.config.velocity.frames;
        let columns = &frozen.halves.columns[half];
        let motion = half_crops(pieces, windows, frames, columns, &self.device);
        let net = &frozen.halves.nets[half];
        let mut entries = net.encoder.forward(&frozen.parameters, motion.clone());
        if !self.config.ablation.continuous {
            let codebook = &frozen.codebooks[half];
            let [windows, codes, channels] = entries.dims();
            let nearest = codebook.nearest(entries.reshape([windows * codes, channels]));
            entries = codebook.lookup(nearest).reshape([windows, codes, channels]);
        }
        Examples {
            entries,
            target: motion,
        }
    }

    /// The root's columns of some crops.
    fn root_target(&self, pieces: &[MotionPiece], windows: &[Draw]) -> Device<A::InnerBackend, 3> {
        let frames = self.config.velocity.frames;
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
        Device::from_data(TensorData::new(values, shape), &self.device)
    }

    /// The loss of some crops, the root's errors of velocity and of its differences, and the halves' part.
    fn losses<B: Kernels>(
        &self,
        parameters: &Parameters<B>,
        (pieces, windows): (&[MotionPiece], &[Draw]),
        lift: impl Fn(Device<A::InnerBackend, 3>) -> Device<B, 3>,
    ) -> [Device<B, 1>; 4] {
        let lower = self.half_examples(1, pieces, windows);
        let target = lift(self.root_target(pieces, windows));
        let found = self.root.forward(parameters, lift(lower.entries.clone()));
        let [velocity, difference, _] = differences(found - target);
        let weight = self.config.velocity.difference_weight;
        let mut loss = velocity.clone() + difference.clone().mul_scalar(weight);
        let mut poses = loss.zeros_like();
        if let Some(decoders) = &self.halves {
            let upper = self.half_examples(0, pieces, windows);
            for (decoder, half) in decoders.iter().zip([upper, lower]) {
                let found = decoder.forward(parameters, lift(half.entries));
                poses = poses + self.pose_loss(found, lift(half.target));
            }
            loss = loss + poses.clone();
        }
        [loss, velocity, difference, poses]
    }

    /// That of stage `vqvae`, and the error of every joint's speed: of several ways that a code may stand for,
    /// the middle one is slower than any.
    fn pose_loss<B: Kernels>(&self, found: Device<B, 3>, target: Device<B, 3>) -> Device<B, 1> {
        let weights = &self.config.vqvae;
        let [position, velocity, acceleration] = differences(found.clone() - target.clone());
        let speed = (speeds(found) - speeds(target)).abs().mean();
        position
            + velocity.mul_scalar(weights.velocity_weight)
            + acceleration.mul_scalar(weights.acceleration_weight)
            + speed.mul_scalar(self.config.velocity.speed_weight)
    }
}

/// What decoders learn from, `[batch, codes, channels]` and `[batch, frames, columns]`.
struct Examples<B: Kernels> {
    entries: Device<B, 3>,
    target: Device<B, 3>,
}

/// Metres that every joint moves in a frame, `[batch, frames - 1, joints, 1]`.
fn speeds<B: Kernels>(motion: Device<B, 3>) -> Device<B, 4> {
    let [batch, frames, columns] = motion.dims();
    let steps = motion.clone().narrow(1, 1, frames - 1) - motion.narrow(1, 0, frames - 1);
    let squares = steps.reshape([batch, frames - 1, columns / 3, 3]).square();
    squares.sum_dim(3).add_scalar(REST).sqrt()
}

impl<A: Trainable> Work<A> for VelocityWork<'_, A> {
    const COLUMNS: &'static [&'static str] = &["loss", "velocity", "difference", "poses"];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let windows = self
            .windows
            .batch(step, self.config.velocity.training.batch);
        let crops = (self.set.training.pieces(), &windows[..]);
        let losses = self.losses(parameters, crops, Device::from_inner);
        let [loss, ..] = losses.clone();
        Losses {
            loss,
            metrics: losses.map(Device::inner).into(),
        }
    }

    const TEST_COLUMNS: &'static [&'static str] = &["test_loss", "test_poses"];

    fn test(&self, parameters: &Parameters<A::InnerBackend>) -> Option<Vec<f32>> {
        let stage = &self.config.velocity;
        let test = self.set.test.as_ref()?;
        let crops = test.crops(stage.frames);
        test_means(&crops, stage.training.batch, |windows| {
            let crops = (test.pieces(), windows);
            let [loss, .., poses] = self.losses(parameters, crops, |tensor| tensor);
            [loss, poses]
        })
    }

    fn save(&self, _saved: &mut Saved) {}

    fn restore(&mut self, _saved: &Saved) -> Result<(), String> {
        Ok(())
    }
}
