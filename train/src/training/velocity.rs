//! Stage `velocity`: the root's decoder on frozen codes of the lower half.
//!
//! With `pose_decoders` the decoders of both halves learn as well: the codes no longer change their
//! meaning, so the decoders can follow them more closely.

use std::path::Path;

use burn_tensor::Tensor;

use super::{
    base::BaseModel,
    config::Config,
    contact::Standing,
    crops::{change, differences, motion_columns, motion_windows, test_means},
    error::TrainError,
    frozen::{FrozenVqVae, HALVES, Halves},
    identity::Identity,
    input::MotionSet,
    kept::{WEIGHT, read_kept},
    piece::MotionPiece,
    stage::Stage,
    trainable::{Losses, StageSpec, TrainableStage},
    windows::Windows,
    world::{energy_error, lengths, world_steps},
};
use crate::{
    data::Draw,
    nn::{DecoderNet, Kernels, Parameters, Store, Trainable},
};

/// The decoders that the stage learns.
pub(super) struct Decoders {
    pub(super) root: DecoderNet,
    /// Those of the upper and lower half, where they learn as well.
    pub(super) halves: Option<[DecoderNet; 2]>,
    pub(super) store: Store,
}

impl Decoders {
    /// Returns the decoders before the first step: the root's with random weights, those of the
    /// halves as they are.
    pub(super) fn new(config: &Config, halves: &Halves) -> Self {
        let mut store = Store::default();
        let root = DecoderNet::new("root", &halves.weights.root, &mut store);
        let mut half = |half: usize| {
            let weights = halves.nets[half].decoder.weights(&halves.store);
            DecoderNet::new(&format!("{}.decoder", HALVES[half]), &weights, &mut store)
        };
        Self { root, halves: config.velocity.pose_decoders.then(|| [half(0), half(1)]), store }
    }

    /// Reads the decoders of the finished stage.
    pub(super) fn trained(config: &Config) -> Result<Self, TrainError> {
        let decoders = Self::new(config, &Halves::random(config));
        let (path, checkpoint) = read_kept(config, Stage::Velocity)?;
        let store = checkpoint.fill(WEIGHT, &decoders.store).map_err(TrainError::state(&path))?;
        Ok(Self { store, ..decoders })
    }
}

/// Stage `velocity`.
pub(super) struct VelocityStage<'a, A: Trainable> {
    config: &'a Config,
    set: &'a MotionSet,
    windows: Windows,
    root: DecoderNet,
    halves: Option<[DecoderNet; 2]>,
    frozen: FrozenVqVae<A::InnerBackend>,
    device: A::Device,
}

impl<'a, A: Trainable> VelocityStage<'a, A> {
    pub(super) fn new(
        config: &'a Config,
        set: &'a MotionSet,
        init: Option<&Path>,
        device: &A::Device,
    ) -> Result<(StageSpec<'a>, Self), TrainError> {
        let settings = &config.velocity;
        let mut frozen = FrozenVqVae::read(config, device)?;
        if let Some(path) = init {
            frozen.halves.weights.root = BaseModel::open(config, path)?.root().clone();
        }
        let Decoders { root, halves, store } = Decoders::new(config, &frozen.halves);
        let crops = (settings.frames, settings.stride);
        let windows = motion_windows(config, set, crops, &settings.balance, config.run.seed ^ 1)?;
        let spec = StageSpec {
            name: "velocity",
            run: &config.run,
            training: &settings.training,
            identity: Identity::of_stage(config, Stage::Velocity, set)?,
            store,
            windows: windows.len(),
        };
        let stage = Self { config, set, windows, root, halves, frozen, device: device.clone() };
        Ok((spec, stage))
    }

    /// Returns the motion of one half, and the entries of its codes.
    fn half_examples(
        &self,
        half: usize,
        pieces: &[MotionPiece],
        windows: &[Draw],
    ) -> Examples<A::InnerBackend> {
        let frozen = &self.frozen;
        let frames = self.config.velocity.frames;
        let columns = &frozen.halves.columns[half];
        let motion = motion_columns(pieces, windows, frames, columns, &self.device);
        let net = &frozen.halves.nets[half];
        let mut entries = net.encoder.forward(&frozen.parameters, motion.clone());
        if !self.config.ablation.continuous {
            entries = frozen.codebooks[half].quantised(entries);
        }
        Examples { entries, target: motion }
    }

    /// Gathers the root's columns of crops.
    fn root_target(&self, pieces: &[MotionPiece], windows: &[Draw]) -> Tensor<A::InnerBackend, 3> {
        let frames = self.config.velocity.frames;
        let columns = self.config.data.root_columns().iter().copied();
        let columns: Vec<_> = columns.map(Some).collect();
        motion_columns(pieces, windows, frames, &columns, &self.device)
    }

    /// Computes the loss of crops, the root's errors of velocity and of its differences, and the
    /// part of the halves.
    fn losses<B: Kernels<Device = A::Device>>(
        &self,
        parameters: &Parameters<B>,
        (pieces, windows): (&[MotionPiece], &[Draw]),
        lift: impl Fn(Tensor<A::InnerBackend, 3>) -> Tensor<B, 3>,
    ) -> [Tensor<B, 1>; 4] {
        let lower = self.half_examples(1, pieces, windows);
        let target = lift(self.root_target(pieces, windows));
        let root = self.root.forward(parameters, lift(lower.entries.clone()));
        let [velocity, difference, _] = differences(root.clone() - target.clone());
        let weight = self.config.velocity.difference_weight;
        let mut loss = velocity.clone() + difference.clone().mul_scalar(weight);
        let mut poses = loss.zeros_like();
        if let Some(decoders) = &self.halves {
            let upper = self.half_examples(0, pieces, windows);
            let columns = &self.frozen.halves.columns;
            for ((decoder, half), columns) in decoders.iter().zip([upper, lower]).zip(columns) {
                let found = decoder.forward(parameters, lift(half.entries));
                if let Some(way) = self.contact_loss(columns, (pieces, windows), [&found, &root]) {
                    poses = poses + way;
                }
                let recorded = lift(half.target);
                if let Some(energy) = self.energy_loss([&found, &recorded], [&root, &target]) {
                    poses = poses + energy;
                }
                poses = poses + self.pose_loss(found, recorded);
            }
            loss = loss + poses.clone();
        }
        [loss, velocity, difference, poses]
    }

    /// Computes the loss of decoded joints' and root's way under standing feet; `None` where it
    /// does not count, or for a half without feet.
    fn contact_loss<B: Kernels<Device = A::Device>>(
        &self,
        columns: &[Option<usize>],
        examples: (&[MotionPiece], &[Draw]),
        [joints, root]: [&Tensor<B, 3>; 2],
    ) -> Option<Tensor<B, 1>> {
        let settings = &self.config.velocity;
        if settings.contact_weight == 0.0 {
            return None;
        }
        let standing = Standing::of(columns, examples, settings.frames, &self.device)?;
        Some(standing.way(joints, root).mul_scalar(settings.contact_weight))
    }

    /// Computes the loss of the kinetic energy of decoded and recorded joints, each carried by its
    /// root; `None` where it does not count.
    fn energy_loss<B: Kernels>(
        &self,
        joints: [&Tensor<B, 3>; 2],
        [found, recorded]: [&Tensor<B, 3>; 2],
    ) -> Option<Tensor<B, 1>> {
        let weight = self.config.velocity.energy_weight;
        (weight > 0.0).then(|| {
            let steps = [world_steps(joints[0], found), world_steps(joints[1], recorded)];
            energy_error(steps).mul_scalar(weight)
        })
    }

    /// Computes the loss of stage `vqvae` plus the error of every joint's speed: where a code
    /// stands for several motions, their mean is slower than each of them.
    fn pose_loss<B: Kernels>(&self, found: Tensor<B, 3>, target: Tensor<B, 3>) -> Tensor<B, 1> {
        let weights = &self.config.vqvae;
        let [position, velocity, acceleration] = differences(found.clone() - target.clone());
        let speed = (speeds(found) - speeds(target)).abs().mean();
        position
            + velocity.mul_scalar(weights.velocity_weight)
            + acceleration.mul_scalar(weights.acceleration_weight)
            + speed.mul_scalar(self.config.velocity.speed_weight)
    }
}

/// Inputs and targets of decoders, `[batch, codes, channels]` and `[batch, frames, columns]`.
struct Examples<B: Kernels> {
    entries: Tensor<B, 3>,
    target: Tensor<B, 3>,
}

/// Returns the metres that every joint moves in a frame, `[batch, frames - 1, joints, 1]`.
fn speeds<B: Kernels>(motion: Tensor<B, 3>) -> Tensor<B, 4> {
    let [batch, frames, columns] = motion.dims();
    lengths(change(motion).reshape([batch, frames - 1, columns / 3, 3]))
}

impl<A: Trainable> TrainableStage<A> for VelocityStage<'_, A> {
    const COLUMNS: &'static [&'static str] = &["loss", "velocity", "difference", "poses"];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let windows = self.windows.batch(step, self.config.velocity.training.batch);
        let crops = (self.set.training.pieces(), &windows[..]);
        let losses = self.losses(parameters, crops, Tensor::from_inner);
        let [loss, ..] = losses.clone();
        Losses { loss, metrics: losses.map(Tensor::inner).into() }
    }

    const TEST_COLUMNS: &'static [&'static str] = &["test_loss", "test_poses"];

    fn test(&self, parameters: &Parameters<A::InnerBackend>) -> Option<Vec<f32>> {
        let settings = &self.config.velocity;
        let test = self.set.test.as_ref()?;
        let crops = test.crops(settings.frames);
        test_means(&crops, settings.training.batch, |windows| {
            let crops = (test.pieces(), windows);
            let [loss, .., poses] = self.losses(parameters, crops, |tensor| tensor);
            [loss, poses]
        })
    }
}
