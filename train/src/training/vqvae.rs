//! Stage `vqvae`: both halves together.

use std::path::Path;

use burn_tensor::{Tensor as Device, TensorData, backend::Backend};

use super::{
    Config, MotionSet, Stage, TrainError,
    input::MotionPiece,
    keep::read_kept,
    runner::{Losses, Plan, WEIGHT, Work},
    saved::Saved,
    windows::{Windows, generator},
};
use crate::{
    checkpoint::Checkpoint,
    data::{CropPlan, Draw},
    nn::{
        Codebook, HalfNet, MovingAverage, Parameters, Store, Trainable, VqVaeSizes, random_vqvae,
        values,
    },
    weights::VqVaeWeights,
};

/// Names of the halves in files.
pub(super) const HALVES: [&str; 2] = ["upper", "lower"];
/// A generator's seed for each purpose of a run.
const CODEBOOK_SEED: u64 = 0x636f_6465;

/// Plans of both halves, and the weights they start from.
pub(super) struct Halves {
    pub(super) nets: [HalfNet; 2],
    pub(super) store: Store,
    pub(super) weights: VqVaeWeights,
    /// Motion columns of each; `None` is always zero.
    pub(super) columns: [Vec<Option<usize>>; 2],
}

impl Halves {
    pub(super) fn new(config: &Config, weights: VqVaeWeights) -> Self {
        let mut store = Store::default();
        let [upper, lower] = HALVES;
        let upper = HalfNet::new(upper, &weights.upper, &mut store);
        let lower = match config.ablation.whole_body {
            // One network stands in both places.
            true => upper.clone(),
            false => HalfNet::new(lower, &weights.lower, &mut store),
        };
        Self {
            nets: [upper, lower],
            store,
            weights,
            columns: config.pose_columns(),
        }
    }

    pub(super) fn random(config: &Config) -> Self {
        let columns = config.pose_columns();
        let sizes = VqVaeSizes {
            half_columns: columns.map(|columns| columns.len()),
            width: config.vqvae.width,
            embedding: config.vqvae.embedding,
            codes: config.vqvae.codes,
            root_columns: config.data.root_columns().len(),
        };
        Self::new(config, random_vqvae(sizes, config.run.seed))
    }
}

/// Both halves as the finished stage left them.
pub(super) struct Trained<B: Backend> {
    pub(super) halves: Halves,
    pub(super) parameters: Parameters<B>,
    pub(super) codebooks: [Codebook<B>; 2],
}

impl<B: Backend> Trained<B> {
    pub(super) fn read(config: &Config, device: &B::Device) -> Result<Self, TrainError> {
        let (path, saved) = read_kept(config, Stage::VqVae)?;
        let failed = |message| TrainError::State {
            path: path.clone(),
            message,
        };
        let mut halves = Halves::random(config);
        halves.store = saved.fill(WEIGHT, &halves.store).map_err(failed)?;
        let codebook = |half| read_codebook(&saved, half, device).map_err(failed);
        let [upper, lower] = HALVES;
        Ok(Self {
            parameters: Parameters::from_store(&halves.store, device),
            codebooks: [codebook(upper)?, codebook(lower)?],
            halves,
        })
    }
}

fn read_codebook<B: Backend>(
    saved: &Saved,
    half: &str,
    device: &B::Device,
) -> Result<Codebook<B>, String> {
    let tensor = |part: &str| saved.tensor(&format!("codebook.{half}.{part}"));
    let state = [tensor("entries")?, tensor("sums")?, tensor("counts")?];
    Ok(Codebook::from_state(state, device))
}

/// Some of the crops' columns, `[batch, frames, columns]`; `None` is zero.
pub(super) fn half_crops<B: Backend>(
    pieces: &[MotionPiece],
    windows: &[Draw],
    frames: usize,
    columns: &[Option<usize>],
    device: &B::Device,
) -> Device<B, 3> {
    let mut values = Vec::with_capacity(windows.len() * frames * columns.len());
    for window in windows {
        let piece = &pieces[window.dance];
        for frame in window.frames(frames) {
            let value = |column| piece.value(frame, column, window.mirrored);
            values.extend(columns.iter().map(|column| column.map_or(0.0, value)));
        }
    }
    let shape = [windows.len(), frames, columns.len()];
    Device::from_data(TensorData::new(values, shape), device)
}

/// Mean absolute value of an error, of its first and of its second difference along time.
pub(super) fn differences<B: Backend>(error: Device<B, 3>) -> [Device<B, 1>; 3] {
    let change = |tensor: Device<B, 3>| {
        let [_, time, _] = tensor.dims();
        tensor.clone().narrow(1, 1, time - 1) - tensor.narrow(1, 0, time - 1)
    };
    let first = change(error.clone());
    let second = change(first.clone());
    [error, first, second].map(|tensor| tensor.abs().mean())
}

/// Means over all of `crops`, taken in batches.
pub(super) fn test_means<B: Backend, const N: usize>(
    crops: &[Draw],
    batch: usize,
    mut means: impl FnMut(&[Draw]) -> [Device<B, 1>; N],
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

pub(super) struct VqVaeWork<'a, A: Trainable> {
    config: &'a Config,
    set: &'a MotionSet,
    windows: Windows,
    nets: [HalfNet; 2],
    columns: [Vec<Option<usize>>; 2],
    codebooks: [Option<Codebook<A::InnerBackend>>; 2],
    device: A::Device,
}

impl<'a, A: Trainable> VqVaeWork<'a, A> {
    pub(super) fn new(
        config: &'a Config,
        set: &'a MotionSet,
        init: Option<&Path>,
        device: &A::Device,
    ) -> Result<(Plan<'a>, Self), TrainError> {
        let stage = &config.vqvae;
        let mut halves = Halves::random(config);
        let mut codebooks = [None, None];
        if let Some(path) = init {
            let weights = VqVaeWeights::from_checkpoint(&mut Checkpoint::open(path)?)?;
            let found = Halves::new(config, weights);
            let tables = [&found.weights.upper.codebook, &found.weights.lower.codebook];
            let wanted = [stage.codes, stage.embedding];
            if !found.store.fits(&halves.store)
                || tables.iter().any(|table| table.shape() != wanted)
            {
                return Err(TrainError::State {
                    path: path.to_owned(),
                    message: "is of other sizes than [vqvae] says".into(),
                });
            }
            codebooks = tables.map(|table| Some(Codebook::new(table, device)));
            halves = found;
        }
        let crops = CropPlan {
            frames: stage.frames,
            stride: stage.stride,
            mirror: config.data.mirror,
        };
        let choices = set.training.motion_choices(config.data.phases);
        let windows = Windows::new(crops, choices, config.run.seed);
        if windows.len() == 0 {
            return Err(TrainError::TooShort {
                length: stage.frames,
                unit: "frames",
            });
        }
        let plan = Plan {
            name: "vqvae",
            run: &config.run,
            training: &stage.training,
            settings: set.settings(config, Stage::VqVae)?,
            store: halves.store,
            windows: windows.len(),
        };
        let work = Self {
            config,
            set,
            windows,
            nets: halves.nets,
            columns: halves.columns,
            codebooks,
            device: device.clone(),
        };
        Ok((plan, work))
    }

    /// Loss of one half, and its metrics.
    fn half(
        &mut self,
        half: usize,
        parameters: &Parameters<A>,
        windows: &[Draw],
        step: u64,
    ) -> (Device<A, 1>, Vec<Device<A::InnerBackend, 1>>) {
        let stage = &self.config.vqvae;
        let pieces = self.set.training.pieces();
        let columns = &self.columns[half];
        let target = half_crops::<A>(pieces, windows, stage.frames, columns, &self.device);
        let net = &self.nets[half];
        let encoded = net.encoder.forward(parameters, target.clone());
        let [batch, codes, channels] = encoded.dims();
        let vectors = encoded.clone().inner().reshape([batch * codes, channels]);
        let seed = self.config.run.seed ^ CODEBOOK_SEED ^ (half as u64) << 32;
        let mut random = generator(seed, step);
        let codebook = self.codebooks[half]
            .get_or_insert_with(|| Codebook::from_batch(vectors.clone(), stage.codes, &mut random));
        let indices = codebook.nearest(vectors.clone());
        let quantised = codebook
            .lookup(indices.clone())
            .reshape([batch, codes, channels]);
        let perplexity = codebook.perplexity(indices.clone());
        let average = MovingAverage {
            decay: stage.decay,
            restart_below: stage.restart_below,
        };
        let restarted = codebook.update(vectors, indices, average, &mut random);

        let quantised = Device::<A, 3>::from_inner(quantised);
        let distance = encoded.clone() - quantised;
        let (passed, distance) = if self.config.ablation.continuous {
            // The codebook looks on: dances start from its entries.
            (encoded, distance.zeros_like())
        } else {
            // Straight through: the value of the entry, the derivative of the encoder's output.
            (encoded - distance.clone().detach(), distance)
        };
        let error = net.decoder.forward(parameters, passed) - target;
        let losses = self.losses(error, distance);
        let [loss, ..] = losses.clone();
        let mut metrics: Vec<_> = losses.map(Device::inner).into();
        metrics.extend([perplexity, restarted]);
        (loss, metrics)
    }

    /// Loss of one half, its parts without weights: position, velocity, acceleration, commitment.
    fn losses<B: Backend>(&self, error: Device<B, 3>, distance: Device<B, 3>) -> [Device<B, 1>; 5] {
        let stage = &self.config.vqvae;
        let commitment = distance.square().mean();
        let [position, velocity, acceleration] = differences(error);
        let loss = position.clone()
            + velocity.clone().mul_scalar(stage.velocity_weight)
            + acceleration.clone().mul_scalar(stage.acceleration_weight)
            + commitment.clone().mul_scalar(stage.commitment);
        [loss, position, velocity, acceleration, commitment]
    }

    /// Loss of one half on test crops, and its error of position.
    fn test_half(
        &self,
        half: usize,
        codebook: &Codebook<A::InnerBackend>,
        parameters: &Parameters<A::InnerBackend>,
        (pieces, crops): (&[MotionPiece], &[Draw]),
    ) -> [Device<A::InnerBackend, 1>; 2] {
        let frames = self.config.vqvae.frames;
        let columns = &self.columns[half];
        let target = half_crops::<A::InnerBackend>(pieces, crops, frames, columns, &self.device);
        let net = &self.nets[half];
        let encoded = net.encoder.forward(parameters, target.clone());
        let [batch, codes, channels] = encoded.dims();
        let quantised = if self.config.ablation.continuous {
            encoded.clone()
        } else {
            let indices = codebook.nearest(encoded.clone().reshape([batch * codes, channels]));
            codebook.lookup(indices).reshape([batch, codes, channels])
        };
        let error = net.decoder.forward(parameters, quantised.clone()) - target;
        let [loss, position, ..] = self.losses(error, encoded - quantised);
        [loss, position]
    }
}

impl<A: Trainable> Work<A> for VqVaeWork<'_, A> {
    const COLUMNS: &'static [&'static str] = &[
        "loss",
        "upper_loss",
        "upper_position",
        "upper_velocity",
        "upper_acceleration",
        "upper_commitment",
        "upper_perplexity",
        "upper_restarts",
        "lower_loss",
        "lower_position",
        "lower_velocity",
        "lower_acceleration",
        "lower_commitment",
        "lower_perplexity",
        "lower_restarts",
    ];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let windows = self.windows.batch(step, self.config.vqvae.training.batch);
        let (upper, upper_metrics) = self.half(0, parameters, &windows, step);
        let (loss, lower_metrics) = if self.config.ablation.whole_body {
            self.codebooks[1] = self.codebooks[0].clone();
            (upper, upper_metrics.clone())
        } else {
            let (lower, metrics) = self.half(1, parameters, &windows, step);
            (upper + lower, metrics)
        };
        let mut metrics = vec![loss.clone().inner()];
        metrics.extend(upper_metrics);
        metrics.extend(lower_metrics);
        Losses { loss, metrics }
    }

    const TEST_COLUMNS: &'static [&'static str] =
        &["test_loss", "test_upper_position", "test_lower_position"];

    fn test(&self, parameters: &Parameters<A::InnerBackend>) -> Option<Vec<f32>> {
        let stage = &self.config.vqvae;
        let test = self.set.test.as_ref()?;
        let [Some(upper), Some(lower)] = &self.codebooks else {
            return None;
        };
        let crops = test.crops(stage.frames);
        test_means(&crops, stage.training.batch, |crops| {
            let half =
                |half, codebook| self.test_half(half, codebook, parameters, (test.pieces(), crops));
            let [upper_loss, upper_position] = half(0, upper);
            if self.config.ablation.whole_body {
                return [upper_loss, upper_position.clone(), upper_position];
            }
            let [lower_loss, lower_position] = half(1, lower);
            [upper_loss + lower_loss, upper_position, lower_position]
        })
    }

    fn save(&self, saved: &mut Saved) {
        for (half, codebook) in HALVES.iter().zip(&self.codebooks) {
            let Some(codebook) = codebook else { continue };
            let parts = ["entries", "sums", "counts"].into_iter();
            for (part, tensor) in parts.zip(codebook.state()) {
                saved
                    .tensors
                    .insert(format!("codebook.{half}.{part}"), tensor);
            }
        }
    }

    fn restore(&mut self, saved: &Saved) -> Result<(), String> {
        for (half, codebook) in HALVES.iter().zip(&mut self.codebooks) {
            *codebook = Some(read_codebook(saved, half, &self.device)?);
        }
        Ok(())
    }
}
