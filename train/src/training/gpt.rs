//! Stage `gpt`: the next codes from codes and music, on frozen codes of both halves.

use std::{collections::BTreeSet, io::Write, path::Path};

use burn_tensor::{Int, Tensor, activation::log_softmax, backend::Backend};

use super::{
    base::BaseModel,
    checkpoint::Checkpoint,
    codes::{Augmentation, Codes},
    condition::{Condition, Conditions},
    config::Config,
    crops::test_means,
    energy::EnergyScale,
    error::TrainError,
    frozen::{FrozenVqVae, HALVES, read_entries},
    identity::Identity,
    input::MotionSet,
    kept::{WEIGHT, read_kept},
    manners::Manners,
    music_scale::MusicScale,
    piece::MotionPiece,
    policy::{put_style_codes, put_style_starts, random},
    repertoire::Repertoire,
    stage::Stage,
    time_shift::{InputCorruption, TimeShiftAugmentation},
    trainable::{Losses, StageSpec, TrainableStage},
    windows::{Windows, generator},
};
use crate::{
    checkpoint::TorchCheckpoint,
    data::{Choice, CropPlan, Draw, FRAMES_PER_CODE, PHASES},
    nn::{self, GptNet, Kernels, Parameters, Store, Trainable, gathered},
    weights::GptWeights,
};

/// Seeds of the generators of replaced codes, time shifts and conditions, beside the run's seed.
const NOISE_SEED: u64 = 0x6E6F_6973;
const SHIFT_SEED: u64 = 0x736C_6970;
const CONDITION_SEED: u64 = 0x636F_6E64;

/// Stage `gpt`.
pub(super) struct GptStage<'a, A: Trainable> {
    config: &'a Config,
    set: &'a MotionSet,
    windows: Windows,
    net: GptNet,
    codes: Codes,
    test_codes: Option<Codes>,
    scale: MusicScale,
    manners: Manners,
    energy: Option<EnergyScale>,
    device: A::Device,
}

/// The weights that training starts from.
pub(super) struct Start {
    pub(super) net: GptNet,
    pub(super) store: Store,
    pub(super) scale: MusicScale,
    pub(super) manners: Manners,
}

impl Start {
    /// Reads the weights of `init`, a model directory, a run's checkpoint or an official one, else
    /// draws random ones; for music of so many columns.
    pub(super) fn read(
        config: &Config,
        set: &MotionSet,
        music_columns: usize,
        init: Option<&Path>,
    ) -> Result<Self, TrainError> {
        let mut store = Store::default();
        let manners = Manners {
            styles: if config.gpt.styles { set.styles.clone() } else { Vec::new() },
            energy: config.gpt.energy,
        };
        let columns = music_columns + manners.spec().columns();
        let net = config.ablation.network(&random(config, columns), &mut store);
        let scale = MusicScale::measure(&set.training, columns, &config.gpt);
        let start = Self { net, store, scale, manners };
        let Some(path) = init else {
            return Ok(start);
        };
        if path.is_dir() {
            let base = BaseModel::open(config, path)?;
            let (vqvae, checkpoint) = read_kept(config, Stage::VqVae)?;
            let [upper, lower] = HALVES.map(|half| read_entries(&checkpoint, half));
            let entries = || Ok::<_, String>([upper?, lower?]);
            let codebooks = entries().map_err(TrainError::state(&vqvae))?;
            let weights = base.gpt(codebooks, columns, &start.manners.styles)?;
            return start.with_official(config, weights).map_err(TrainError::state(path));
        }
        match Checkpoint::of_extension(path)? {
            Some(checkpoint) => {
                start.with_checkpoint(config, &checkpoint).map_err(TrainError::state(path))
            }
            None => {
                let checkpoint = &mut TorchCheckpoint::open(path)?;
                let weights = GptWeights::from_checkpoint(checkpoint, config.gpt.heads)?;
                start.with_official(config, weights).map_err(TrainError::state(path))
            }
        }
    }

    fn with_checkpoint(self, config: &Config, checkpoint: &Checkpoint) -> Result<Self, String> {
        if Manners::restore(checkpoint)? != self.manners {
            return Err(
                "was trained with other styles: give it the same data folders, gpt.styles \
                        and gpt.energy"
                    .into(),
            );
        }
        Ok(Self {
            store: checkpoint.fill(WEIGHT, &self.store)?,
            scale: MusicScale::restore_for(&config.gpt, checkpoint)?,
            ..self
        })
    }

    /// Takes weights for plain features, and brings them to the scale of the training music.
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

/// Returns the windows that the stage learns from; `None` where no motion is long enough.
fn windows(config: &Config, set: &MotionSet) -> Option<Windows> {
    let crops = CropPlan {
        frames: (config.gpt.block + 1) * FRAMES_PER_CODE,
        stride: config.gpt.stride * FRAMES_PER_CODE,
        mirror: config.data.mirror,
    };
    let choices = music_choices(config, set);
    let windows = Windows::new(crops, choices, config.run.seed ^ 2)?;
    Some(windows.balanced(&config.gpt.balance, set.training.pieces()))
}

/// Returns the choices of each motion.
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

/// Returns the number of start phases for which codes are needed.
fn code_phases(config: &Config, set: &MotionSet) -> usize {
    // A shift may be of any number of frames.
    if TimeShiftAugmentation::new(&config.gpt).is_some() {
        return PHASES;
    }
    let pieces = set.training.pieces().iter();
    let drawn = pieces.map(|piece| piece.phases(config.gpt_phases()));
    drawn.max().unwrap_or(1)
}

impl<'a, A: Trainable> GptStage<'a, A> {
    pub(super) fn new(
        config: &'a Config,
        set: &'a MotionSet,
        init: Option<&Path>,
        device: &A::Device,
        output: &mut impl Write,
    ) -> Result<(StageSpec<'a>, Self), TrainError> {
        let mut songs = set.training.pieces().iter().flat_map(MotionPiece::songs);
        let columns = songs.next().map(|song| song.phase(0).ncols());
        let Some((columns, windows)) = columns.zip(windows(config, set)) else {
            return Err(TrainError::TooShort { length: config.gpt.block + 1, unit: "codes" });
        };
        let frozen = FrozenVqVae::<A::InnerBackend>::read(config, device)?;
        let start = Start::read(config, set, columns, init)?;
        let mut encode = |pieces: &[MotionPiece], mirror, phases: usize| {
            let wanted = Augmentation { mirror, phases, vectors: config.ablation.continuous };
            Codes::encode(&frozen, pieces, wanted, device, output)
        };
        let phases = code_phases(config, set);
        let codes = encode(set.training.pieces(), config.data.mirror, phases);
        let test_codes = set.test.as_ref();
        let test_codes = test_codes.map(|test| encode(test.pieces(), false, 1));
        let mut identity = Identity::of_stage(config, Stage::Gpt, set)?;
        if config.gpt.styles {
            identity = identity.with_styles(&start.manners.styles);
        }
        let frames = config.gpt.block * FRAMES_PER_CODE;
        let energy = config.gpt.energy.then(|| {
            let places = windows.places();
            EnergyScale::measure(set.training.pieces(), places, frames)
        });
        let spec = StageSpec {
            name: "gpt",
            run: &config.run,
            training: &config.gpt.training,
            identity,
            store: start.store,
            windows: windows.len(),
        };
        let stage = Self {
            config,
            set,
            windows,
            net: start.net,
            codes,
            test_codes,
            scale: start.scale,
            manners: start.manners,
            energy,
            device: device.clone(),
        };
        Ok((spec, stage))
    }

    /// Returns the codes of the windows, `offset` after their starts, `[batch, block]`.
    fn codes(&self, codes: &Codes, windows: &[Draw], half: usize, offset: usize) -> Vec<i32> {
        let block = self.config.gpt.block;
        let values = windows.iter().flat_map(|window| {
            let first = window.start / FRAMES_PER_CODE + offset;
            &codes.of(window)[half][first..][..block]
        });
        values.copied().collect()
    }

    /// Gathers the vectors of these codes, `[batch, block, channels]`.
    fn vectors<B: Backend<Device = A::Device>>(
        &self,
        codes: &Codes,
        windows: &[Draw],
        half: usize,
        offset: usize,
    ) -> Tensor<B, 3> {
        let (block, channels) = (self.config.gpt.block, self.config.vqvae.embedding);
        let row = |window: &Draw, step: usize| {
            let code = window.start / FRAMES_PER_CODE + offset + step;
            codes.vectors_of(window)[half][code * channels..][..channels].to_vec()
        };
        gathered(windows, [block, channels], row, &self.device)
    }

    /// Gathers the scaled music beside the codes and the manner, `[batch, block, columns]`.
    pub(super) fn music<B: Backend<Device = A::Device>>(
        &self,
        pieces: &[MotionPiece],
        conditions: &[Condition],
    ) -> Tensor<B, 3> {
        let (block, columns) = (self.config.gpt.block, self.scale.mean.len());
        let row = |condition: &Condition, step: usize| {
            let rows = pieces[condition.dance].songs()[condition.song].phase(condition.phase);
            let manner = self.manners.spec().values(condition.manner);
            let music = self.scale.scaled(rows.row(condition.row + step));
            music.chain(manner).collect::<Vec<_>>()
        };
        gathered(conditions, [block, columns], row, &self.device)
    }

    /// Returns the conditions of a step's windows.
    fn conditions(&self, windows: &[Draw], step: u64) -> Vec<Condition> {
        let seed = self.config.run.seed ^ CONDITION_SEED;
        let random = &mut generator(seed, step);
        let conditions = Conditions {
            config: &self.config.gpt,
            manners: &self.manners,
            energy: self.energy.as_ref(),
        };
        let pieces = self.set.training.pieces();
        windows.iter().map(|window| conditions.draw(window, pieces, random)).collect()
    }

    /// Returns the corruption of the pasts of a step's windows.
    fn corruption(&self, windows: &[Draw], step: u64) -> InputCorruption {
        let (stage, seed) = (&self.config.gpt, self.config.run.seed);
        let shifts = TimeShiftAugmentation::new(stage).map(|augmentation| {
            let random = &mut generator(seed ^ SHIFT_SEED, step);
            augmentation.draw(&self.codes, windows, random)
        });
        InputCorruption {
            shifts: shifts.unwrap_or_default(),
            noise: stage.code_noise,
            codes: self.config.vqvae.codes as i32,
            random: generator(seed ^ NOISE_SEED, step),
        }
    }

    /// Computes the loss and the cross-entropy of the next upper and lower codes; without codes,
    /// the mean square of the vectors' errors.
    fn losses<B: Kernels<Device = A::Device>>(
        &self,
        parameters: &Parameters<B>,
        (pieces, codes): (&[MotionPiece], &Codes),
        (windows, conditions): (&[Draw], &[Condition]),
        dropout: f64,
        corruption: Option<InputCorruption>,
    ) -> [Tensor<B, 1>; 3] {
        let music = self.music(pieces, conditions);
        if self.config.ablation.continuous {
            let history = [0, 1].map(|half| self.vectors(codes, windows, half, 0));
            let found = self.net.regress(parameters, music, history, dropout);
            let error = |found: Tensor<B, 3>, half| {
                let target = self.vectors(codes, windows, half, 1);
                (found - target).square().mean()
            };
            let (upper, lower) = (error(found.upper, 0), error(found.lower, 1));
            return [upper.clone() + lower.clone(), upper, lower];
        }
        let block = self.config.gpt.block;
        let mut history = [0, 1].map(|half| self.codes(codes, windows, half, 0));
        if let Some(mut corruption) = corruption {
            for (half, codes) in history.iter_mut().enumerate() {
                corruption.apply(codes, half, block);
            }
        }
        let on_device = |codes: Vec<i32>| -> Tensor<B, 2, Int> {
            nn::codes(codes, [windows.len(), block], &self.device)
        };
        let history = history.map(on_device);
        let logits = self.net.forward(parameters, music, history, dropout);
        let entropy = |logits: Tensor<B, 3>, half| {
            let targets = on_device(self.codes(codes, windows, half, 1)).unsqueeze_dim::<3>(2);
            log_softmax(logits, 2).gather(2, targets).mean().neg()
        };
        let (upper, lower) = (entropy(logits.upper, 0), entropy(logits.lower, 1));
        [upper.clone() + lower.clone(), upper, lower]
    }

    /// Returns the first frame of each motion that is learned.
    fn first_frames(&self) -> Vec<usize> {
        let choices = music_choices(self.config, self.set).into_iter();
        choices.map(|choice| choice.skipped).collect()
    }
}

impl<A: Trainable> TrainableStage<A> for GptStage<'_, A> {
    const COLUMNS: &'static [&'static str] = &["loss", "upper", "lower"];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let stage = &self.config.gpt;
        let windows = self.windows.batch(step, stage.training.batch);
        let examples = (self.set.training.pieces(), &self.codes);
        let corruption = Some(self.corruption(&windows, step));
        let conditions = self.conditions(&windows, step);
        let windows = (&windows[..], &conditions[..]);
        let losses = self.losses(parameters, examples, windows, stage.dropout, corruption);
        let [loss, ..] = losses.clone();
        Losses { loss, metrics: losses.map(Tensor::inner).into() }
    }

    const TEST_COLUMNS: &'static [&'static str] = &["test_loss", "test_upper", "test_lower"];

    fn test(&self, parameters: &Parameters<A::InnerBackend>) -> Option<Vec<f32>> {
        let stage = &self.config.gpt;
        let (test, codes) = (self.set.test.as_ref()?, self.test_codes.as_ref()?);
        let stride = stage.block * FRAMES_PER_CODE;
        let windows = test.crops_with_music(stride + FRAMES_PER_CODE, stride);
        test_means(&windows, stage.training.batch, |windows| {
            let pieces = test.pieces();
            let conditions = windows.iter();
            let conditions: Vec<_> = conditions
                .map(|window| Condition::with_style(window, pieces, &self.manners))
                .collect();
            self.losses(parameters, (pieces, codes), (windows, &conditions), 0.0, None)
        })
    }

    fn save(&self, checkpoint: &mut Checkpoint) {
        self.scale.save(checkpoint);
        self.manners.save(checkpoint);
        let firsts = self.first_frames();
        let starts: BTreeSet<[u32; 2]> = self.codes.starts(&firsts).map(|(_, pair)| pair).collect();
        let values: Vec<f32> = starts.iter().flatten().map(|&code| code as f32).collect();
        checkpoint.put_rows("start_codes", 2, &values);
        let styles = &self.manners.styles;
        let repertoire = Repertoire { codes: &self.codes, pieces: self.set.training.pieces() };
        put_style_starts(checkpoint, styles, &repertoire.starts(styles, &firsts));
        put_style_codes(checkpoint, styles, &repertoire.style_codes(styles));
    }

    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), String> {
        self.scale = MusicScale::restore(checkpoint)?;
        Ok(())
    }
}
