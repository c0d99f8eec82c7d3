//! Stage `gpt`: the next codes from codes and music, on frozen codes of both halves.

use std::{collections::BTreeSet, io::Write, path::Path};

use burn_tensor::{Int, Tensor as Device, TensorData, activation::log_softmax, backend::Backend};

use super::{
    Config, FRAMES_PER_CODE, MotionPiece, MotionSet, Stage, TrainError,
    codes::{Augmentation, Codes},
    music_scale::MusicScale,
    runner::{Losses, Plan, WEIGHT, Work},
    saved::Saved,
    slips::{Disturbance, Slips},
    vqvae::{Trained, test_means},
    windows::{Windows, generator},
};
use crate::{
    Tensor,
    checkpoint::Checkpoint,
    data::{Choice, CropPlan, Draw, PHASES, rows_beside},
    nn::{GptNet, GptSizes, Kernels, Parameters, Store, Trainable, random_gpt},
    weights::GptWeights,
};

/// What the generators of replaced codes and of slips are seeded with, beside the run's seed.
const NOISE_SEED: u64 = 0x6E6F_6973;
const SLIP_SEED: u64 = 0x736C_6970;

pub(super) struct GptWork<'a, A: Trainable> {
    config: &'a Config,
    set: &'a MotionSet,
    windows: Windows,
    net: GptNet,
    codes: Codes,
    test_codes: Option<Codes>,
    scale: MusicScale,
    device: A::Device,
}

/// A network of the configured size.
pub(super) fn random(config: &Config, columns: usize) -> GptWeights {
    let gpt = &config.gpt;
    let codes = match config.ablation.continuous {
        true => config.vqvae.embedding,
        false => config.vqvae.codes,
    };
    let sizes = GptSizes {
        channels: gpt.channels,
        heads: gpt.heads,
        layers: gpt.base_layers + gpt.head_layers,
        block: gpt.block,
        codes: [codes, codes],
        columns,
    };
    random_gpt(sizes, config.run.seed ^ 2)
}

/// What training starts from.
pub(super) struct Start {
    pub(super) net: GptNet,
    pub(super) store: Store,
    pub(super) scale: MusicScale,
}

impl Start {
    /// Weights of `init`, a run's checkpoint or an official one, else random ones.
    pub(super) fn read(
        config: &Config,
        set: &MotionSet,
        columns: usize,
        init: Option<&Path>,
    ) -> Result<Self, TrainError> {
        let mut store = Store::default();
        let net = config
            .ablation
            .network(&random(config, columns), &mut store);
        let scale = MusicScale::measure(&set.training, columns, &config.gpt);
        let start = Self { net, store, scale };
        let Some(path) = init else {
            return Ok(start);
        };
        let state = |message: String| TrainError::State {
            path: path.to_owned(),
            message,
        };
        match Saved::of_extension(path)? {
            Some(saved) => start.with_saved(config, &saved).map_err(state),
            None => {
                let checkpoint = &mut Checkpoint::open(path)?;
                let weights = GptWeights::from_checkpoint(checkpoint, config.gpt.heads)?;
                start.with_official(config, weights).map_err(state)
            }
        }
    }

    fn with_saved(self, config: &Config, saved: &Saved) -> Result<Self, String> {
        Ok(Self {
            store: saved.fill(WEIGHT, &self.store)?,
            scale: MusicScale::restore_for(&config.gpt, saved)?,
            net: self.net,
        })
    }

    /// The weights of plain features are brought to the scale of the training music.
    fn with_official(self, config: &Config, mut weights: GptWeights) -> Result<Self, String> {
        let mut store = Store::default();
        let sizes = "is of other sizes than [gpt] and [vqvae] say";
        if weights.music.weight.shape().get(1) != Some(&self.scale.mean.len()) {
            return Err(sizes.into());
        }
        weights.music = self.scale.unfold(&weights.music);
        let net = config.ablation.network(&weights, &mut store);
        if !store.fits(&self.store) {
            return Err(sizes.into());
        }
        Ok(Self { net, store, ..self })
    }
}

/// The windows that are learned from.
fn windows(config: &Config, set: &MotionSet) -> Windows {
    let stage = &config.gpt;
    let crops = CropPlan {
        frames: (stage.block + 1) * FRAMES_PER_CODE,
        stride: stage.stride * FRAMES_PER_CODE,
        mirror: config.data.mirror,
    };
    let choices = music_choices(config, set);
    Windows::new(crops, choices, config.run.seed ^ 2)
}

/// What can be drawn of each dance.
fn music_choices(config: &Config, set: &MotionSet) -> Vec<Choice> {
    let mut choices = set.training.music_choices(config.gpt_phases());
    if config.gpt.trim_still {
        for (choice, piece) in choices.iter_mut().zip(set.training.pieces()) {
            let dancing = piece.dancing();
            choice.skipped = dancing.start;
            choice.frames = choice.frames.min(dancing.end);
        }
    }
    choices
}

/// Start phases that codes of the training split are needed for.
fn code_phases(config: &Config, set: &MotionSet) -> usize {
    // A slip may be of any number of frames.
    if Slips::new(&config.gpt).is_some() {
        return PHASES;
    }
    let pieces = set.training.pieces().iter();
    let drawn = pieces.map(|piece| piece.phases(config.gpt_phases()));
    drawn.max().unwrap_or(1)
}

impl<'a, A: Trainable> GptWork<'a, A> {
    pub(super) fn new(
        config: &'a Config,
        set: &'a MotionSet,
        init: Option<&Path>,
        device: &A::Device,
        output: &mut impl Write,
    ) -> Result<(Plan<'a>, Self), TrainError> {
        let stage = &config.gpt;
        let too_short = TrainError::TooShort {
            length: stage.block + 1,
            unit: "codes",
        };
        let mut songs = set.training.pieces().iter().flat_map(MotionPiece::songs);
        let Some(columns) = songs.next().map(|song| song.phase(0).ncols()) else {
            return Err(too_short);
        };
        let windows = windows(config, set);
        if windows.len() == 0 {
            return Err(too_short);
        }
        let frozen = Trained::<A::InnerBackend>::read(config, device)?;
        let start = Start::read(config, set, columns, init)?;
        let mut encode = |pieces: &[MotionPiece], mirror, phases: usize| {
            let wanted = Augmentation {
                mirror,
                phases,
                vectors: config.ablation.continuous,
            };
            Codes::encode(&frozen, pieces, wanted, device, output)
        };
        let phases = code_phases(config, set);
        let codes = encode(set.training.pieces(), config.data.mirror, phases);
        let test_codes = set.test.as_ref();
        let test_codes = test_codes.map(|test| encode(test.pieces(), false, 1));
        let plan = Plan {
            name: "gpt",
            run: &config.run,
            training: &stage.training,
            settings: set.settings(config, Stage::Gpt)?,
            store: start.store,
            windows: windows.len(),
        };
        let work = Self {
            config,
            set,
            windows,
            net: start.net,
            codes,
            test_codes,
            scale: start.scale,
            device: device.clone(),
        };
        Ok((plan, work))
    }

    /// Codes beside the windows, `offset` behind their starts, `[batch, block]`.
    fn codes(&self, codes: &Codes, windows: &[Draw], half: usize, offset: usize) -> Vec<i32> {
        let block = self.config.gpt.block;
        let values = windows.iter().flat_map(|window| {
            let first = window.start / FRAMES_PER_CODE + offset;
            &codes.of(window)[half][first..][..block]
        });
        values.copied().collect()
    }

    /// The vectors behind these codes, `[batch, block, channels]`.
    fn vectors<B: Backend<Device = A::Device>>(
        &self,
        codes: &Codes,
        windows: &[Draw],
        half: usize,
        offset: usize,
    ) -> Device<B, 3> {
        let (block, channels) = (self.config.gpt.block, self.config.vqvae.embedding);
        let mut values: Vec<f32> = Vec::with_capacity(windows.len() * block * channels);
        for window in windows {
            let first = (window.start / FRAMES_PER_CODE + offset) * channels;
            values.extend(&codes.vectors_of(window)[half][first..][..block * channels]);
        }
        let shape = [windows.len(), block, channels];
        Device::from_data(TensorData::new(values, shape), &self.device)
    }

    pub(super) fn music<B: Backend<Device = A::Device>>(
        &self,
        pieces: &[MotionPiece],
        windows: &[Draw],
    ) -> Device<B, 3> {
        let (block, columns) = (self.config.gpt.block, self.scale.mean.len());
        let mut values = Vec::with_capacity(windows.len() * block * columns);
        for window in windows {
            let rows = pieces[window.dance].songs()[window.song].phase(window.phase);
            for row in rows_beside(window.codes(block * FRAMES_PER_CODE)) {
                let row = rows.row(row);
                values.extend(self.scale.seen(row));
            }
        }
        let shape = [windows.len(), block, columns];
        Device::from_data(TensorData::new(values, shape), &self.device)
    }

    /// How the pasts of a step's windows are disturbed.
    fn disturbance(&self, windows: &[Draw], step: u64) -> Disturbance {
        let (stage, seed) = (&self.config.gpt, self.config.run.seed);
        let slips = Slips::new(stage).map(|slips| {
            let random = &mut generator(seed ^ SLIP_SEED, step);
            slips.draw(&self.codes, windows, random)
        });
        Disturbance {
            slips: slips.unwrap_or_default(),
            noise: stage.code_noise,
            codes: self.config.vqvae.codes as i32,
            random: generator(seed ^ NOISE_SEED, step),
        }
    }

    /// Loss, cross-entropy of the upper and of the lower codes that come next; without codes, the
    /// mean square of the vectors' errors.
    fn losses<B: Kernels<Device = A::Device>>(
        &self,
        parameters: &Parameters<B>,
        (pieces, codes): (&[MotionPiece], &Codes),
        windows: &[Draw],
        dropout: f64,
        disturbance: Option<Disturbance>,
    ) -> [Device<B, 1>; 3] {
        let music = self.music(pieces, windows);
        if self.config.ablation.continuous {
            let history = [0, 1].map(|half| self.vectors(codes, windows, half, 0));
            let found = self.net.regress(parameters, music, history, dropout);
            let error = |found: Device<B, 3>, half| {
                let target = self.vectors(codes, windows, half, 1);
                (found - target).square().mean()
            };
            let (upper, lower) = (error(found.upper, 0), error(found.lower, 1));
            return [upper.clone() + lower.clone(), upper, lower];
        }
        let block = self.config.gpt.block;
        let mut history = [0, 1].map(|half| self.codes(codes, windows, half, 0));
        if let Some(mut disturbance) = disturbance {
            for (half, codes) in history.iter_mut().enumerate() {
                disturbance.disturb(codes, half, block);
            }
        }
        let on_device = |codes: Vec<i32>| -> Device<B, 2, Int> {
            Device::from_data(TensorData::new(codes, [windows.len(), block]), &self.device)
        };
        let history = history.map(on_device);
        let logits = self.net.forward(parameters, music, history, dropout);
        let entropy = |logits: Device<B, 3>, half| {
            let targets = on_device(self.codes(codes, windows, half, 1)).unsqueeze_dim::<3>(2);
            log_softmax(logits, 2).gather(2, targets).mean().neg()
        };
        let (upper, lower) = (entropy(logits.upper, 0), entropy(logits.lower, 1));
        [upper.clone() + lower.clone(), upper, lower]
    }

    /// The first frame of each dance that is learned.
    fn first_frames(&self) -> Vec<usize> {
        let choices = music_choices(self.config, self.set).into_iter();
        choices.map(|choice| choice.skipped).collect()
    }
}

impl<A: Trainable> Work<A> for GptWork<'_, A> {
    const COLUMNS: &'static [&'static str] = &["loss", "upper", "lower"];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let stage = &self.config.gpt;
        let windows = self.windows.batch(step, stage.training.batch);
        let examples = (self.set.training.pieces(), &self.codes);
        let disturbance = self.disturbance(&windows, step);
        let losses = self.losses(
            parameters,
            examples,
            &windows,
            stage.dropout,
            Some(disturbance),
        );
        let [loss, ..] = losses.clone();
        Losses {
            loss,
            metrics: losses.map(Device::inner).into(),
        }
    }

    const TEST_COLUMNS: &'static [&'static str] = &["test_loss", "test_upper", "test_lower"];

    fn test(&self, parameters: &Parameters<A::InnerBackend>) -> Option<Vec<f32>> {
        let stage = &self.config.gpt;
        let (test, codes) = (self.set.test.as_ref()?, self.test_codes.as_ref()?);
        let stride = stage.block * FRAMES_PER_CODE;
        let windows = test.crops_with_music(stride + FRAMES_PER_CODE, stride);
        test_means(&windows, stage.training.batch, |windows| {
            self.losses(parameters, (test.pieces(), codes), windows, 0.0, None)
        })
    }

    fn save(&self, saved: &mut Saved) {
        let column = |values: &[f32]| Tensor::from_fn(vec![values.len()], |place| values[place]);
        let scale = &self.scale;
        saved
            .tensors
            .insert("music.mean".into(), column(&scale.mean));
        saved
            .tensors
            .insert("music.spread".into(), column(&scale.spread));
        let starts: BTreeSet<[i32; 2]> = self.codes.starts(&self.first_frames()).collect();
        let values: Vec<f32> = starts.iter().flatten().map(|&code| code as f32).collect();
        let starts = Tensor::from_fn(vec![starts.len(), 2], |place| values[place]);
        saved.tensors.insert("start_codes".into(), starts);
    }

    fn restore(&mut self, saved: &Saved) -> Result<(), String> {
        self.scale = MusicScale::restore(saved)?;
        Ok(())
    }
}
