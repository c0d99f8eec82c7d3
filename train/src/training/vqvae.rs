//! Stage `vqvae`: both halves of the pose VQ-VAE together.

use std::path::Path;

use burn_tensor::Tensor;

use super::{
    base::BaseModel,
    checkpoint::Checkpoint,
    config::Config,
    contact::Standing,
    crops::{differences, motion_columns, motion_windows, test_means},
    error::TrainError,
    frozen::{HALVES, Halves, read_codebook, save_codebook},
    identity::Identity,
    input::MotionSet,
    piece::MotionPiece,
    stage::Stage,
    trainable::{Losses, StageSpec, TrainableStage},
    windows::{Windows, generator},
};
use crate::{
    checkpoint::TorchCheckpoint,
    data::Draw,
    nn::{Codebook, HalfNet, Kernels, MovingAverage, Parameters, Trainable},
    weights::VqVaeWeights,
};

/// A generator's seed for each purpose of a run.
const CODEBOOK_SEED: u64 = 0x636f_6465;

/// Stage `vqvae`.
pub(super) struct VqVaeStage<'a, A: Trainable> {
    config: &'a Config,
    set: &'a MotionSet,
    windows: Windows,
    nets: [HalfNet; 2],
    columns: [Vec<Option<usize>>; 2],
    codebooks: [Option<Codebook<A::InnerBackend>>; 2],
    device: A::Device,
}

impl<'a, A: Trainable> VqVaeStage<'a, A> {
    pub(super) fn new(
        config: &'a Config,
        set: &'a MotionSet,
        init: Option<&Path>,
        device: &A::Device,
    ) -> Result<(StageSpec<'a>, Self), TrainError> {
        let settings = &config.vqvae;
        let mut halves = Halves::random(config);
        let mut codebooks = [None, None];
        if let Some(path) = init {
            let (weights, known) = if path.is_dir() {
                let base = BaseModel::open(config, path)?;
                (base.vqvae(settings.codes)?, base.codes())
            } else {
                let checkpoint = &mut TorchCheckpoint::open(path)?;
                (VqVaeWeights::from_checkpoint(checkpoint)?, settings.codes)
            };
            let found = Halves::new(config, weights);
            let tables = [&found.weights.upper.codebook, &found.weights.lower.codebook];
            let wanted = [settings.codes, settings.embedding];
            if !found.store.fits(&halves.store)
                || tables.iter().any(|table| table.shape() != wanted)
            {
                return Err(TrainError::State {
                    path: path.to_owned(),
                    message: "is of other sizes than [vqvae] says".into(),
                });
            }
            codebooks = tables.map(|table| Some(Codebook::begun(table, known, device)));
            halves = found;
        }
        let crops = (settings.frames, settings.stride);
        let windows = motion_windows(config, set, crops, &settings.balance, config.run.seed)?;
        let spec = StageSpec {
            name: "vqvae",
            run: &config.run,
            training: &settings.training,
            identity: Identity::of_stage(config, Stage::VqVae, set)?,
            store: halves.store,
            windows: windows.len(),
        };
        let stage = Self {
            config,
            set,
            windows,
            nets: halves.nets,
            columns: halves.columns,
            codebooks,
            device: device.clone(),
        };
        Ok((spec, stage))
    }

    /// Computes the loss of one half, and its metrics.
    fn half(
        &mut self,
        half: usize,
        parameters: &Parameters<A>,
        windows: &[Draw],
        step: u64,
    ) -> (Tensor<A, 1>, Vec<Tensor<A::InnerBackend, 1>>) {
        let settings = &self.config.vqvae;
        let pieces = self.set.training.pieces();
        let columns = &self.columns[half];
        let target = motion_columns::<A>(pieces, windows, settings.frames, columns, &self.device);
        let net = &self.nets[half];
        let encoded = net.encoder.forward(parameters, target.clone());
        let [batch, codes, channels] = encoded.dims();
        let vectors = encoded.clone().inner().reshape([batch * codes, channels]);
        let seed = self.config.run.seed ^ CODEBOOK_SEED ^ (half as u64) << 32;
        let mut random = generator(seed, step);
        let codebook = self.codebooks[half].get_or_insert_with(|| {
            Codebook::from_batch(vectors.clone(), settings.codes, &mut random)
        });
        let indices = codebook.nearest(vectors.clone());
        let quantised = codebook.lookup(indices.clone()).reshape([batch, codes, channels]);
        let perplexity = codebook.perplexity(indices.clone());
        let average =
            MovingAverage { decay: settings.decay, restart_below: settings.restart_below };
        let restarted = codebook.update(vectors, indices, average, &mut random);

        let quantised = Tensor::<A, 3>::from_inner(quantised);
        let distance = encoded.clone() - quantised;
        let (passed, distance) = if self.config.ablation.continuous {
            // The codebook only follows: generation starts from its entries.
            (encoded, distance.zeros_like())
        } else {
            // Straight through: the value of the entry, the derivative of the encoder's output.
            (encoded - distance.clone().detach(), distance)
        };
        let error = net.decoder.forward(parameters, passed) - target;
        let losses = self.losses(half, error, distance, (pieces, windows));
        let [loss, ..] = losses.clone();
        let mut metrics: Vec<_> = losses.map(Tensor::inner).into();
        metrics.extend([perplexity, restarted]);
        (loss, metrics)
    }

    /// Computes the loss of one half and its unweighted parts: position, velocity, acceleration,
    /// commitment.
    fn losses<B: Kernels<Device = A::Device>>(
        &self,
        half: usize,
        error: Tensor<B, 3>,
        distance: Tensor<B, 3>,
        crops: (&[MotionPiece], &[Draw]),
    ) -> [Tensor<B, 1>; 5] {
        let settings = &self.config.vqvae;
        let commitment = distance.square().mean();
        let standing = (settings.contact_weight > 0.0).then(|| {
            let columns = &self.columns[half];
            Standing::of(columns, crops, settings.frames, &self.device)
        });
        let feet = standing.flatten().map(|standing| standing.velocity_error(&error));
        let [position, velocity, acceleration] = differences(error);
        let mut loss = position.clone()
            + velocity.clone().mul_scalar(settings.velocity_weight)
            + acceleration.clone().mul_scalar(settings.acceleration_weight)
            + commitment.clone().mul_scalar(settings.commitment);
        if let Some(feet) = feet {
            loss = loss + feet.mul_scalar(settings.contact_weight);
        }
        [loss, position, velocity, acceleration, commitment]
    }

    /// Computes the loss of one half on test crops, and its error of position.
    fn test_half(
        &self,
        half: usize,
        codebook: &Codebook<A::InnerBackend>,
        parameters: &Parameters<A::InnerBackend>,
        (pieces, crops): (&[MotionPiece], &[Draw]),
    ) -> [Tensor<A::InnerBackend, 1>; 2] {
        let frames = self.config.vqvae.frames;
        let columns = &self.columns[half];
        let target =
            motion_columns::<A::InnerBackend>(pieces, crops, frames, columns, &self.device);
        let net = &self.nets[half];
        let encoded = net.encoder.forward(parameters, target.clone());
        let quantised = match self.config.ablation.continuous {
            true => encoded.clone(),
            false => codebook.quantised(encoded.clone()),
        };
        let error = net.decoder.forward(parameters, quantised.clone()) - target;
        let distance = encoded - quantised;
        let [loss, position, ..] = self.losses(half, error, distance, (pieces, crops));
        [loss, position]
    }
}

impl<A: Trainable> TrainableStage<A> for VqVaeStage<'_, A> {
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
        let settings = &self.config.vqvae;
        let test = self.set.test.as_ref()?;
        let [Some(upper), Some(lower)] = &self.codebooks else {
            return None;
        };
        let crops = test.crops(settings.frames);
        test_means(&crops, settings.training.batch, |crops| {
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

    fn save(&self, checkpoint: &mut Checkpoint) {
        for (half, codebook) in HALVES.iter().zip(&self.codebooks) {
            if let Some(codebook) = codebook {
                save_codebook(checkpoint, half, codebook);
            }
        }
    }

    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), String> {
        for (half, codebook) in HALVES.iter().zip(&mut self.codebooks) {
            *codebook = Some(read_codebook(checkpoint, half, &self.device)?);
        }
        Ok(())
    }
}
