//! Stage `gpt`: the next codes from codes and music, on frozen codes of both halves.

use std::{collections::BTreeSet, io::Write, path::Path};

use burn_tensor::{Int, Tensor as Device, TensorData, activation::log_softmax, backend::Backend};
use ndarray::ArrayView1;

use super::{
    Config, Dances, FRAMES_PER_CODE, MotionPiece, MotionSet, Stage, TrainError,
    codes::{Augmentation, Codes},
    config::{GptConfig, Hear},
    runner::{Losses, Plan, WEIGHT, Work},
    saved::Saved,
    slips::{Disturbance, Slips},
    vqvae::{Trained, test_means},
    windows::{Windows, generator},
};
use crate::{
    Tensor,
    checkpoint::Checkpoint,
    data::{CropPlan, Draw, PHASES, Training, rows_beside},
    nn::{GptNet, GptSizes, Kernels, Parameters, Store, Trainable, random_gpt},
    weights::{GptWeights, Linear},
};
use bailando::features::{BEAT_COLUMN, COLUMNS, ONSET_COLUMN};

/// Music columns that hardly move are not blown up beyond this.
const SMALLEST_SPREAD: f32 = 1e-3;

/// What the generators of replaced codes and of slips are seeded with, beside the run's seed.
const NOISE_SEED: u64 = 0x6E6F_6973;
const SLIP_SEED: u64 = 0x736C_6970;

/// The spread of a column that is not heard: the largest that can be saved.
const MUTED: f32 = f32::MAX;

/// Mean and spread of each music column; training sees `(row - mean) / spread`.
#[derive(Clone, Debug)]
pub(super) struct MusicScale {
    pub(super) mean: Vec<f32>,
    pub(super) spread: Vec<f32>,
}

impl MusicScale {
    /// Over the first phase of all songs; dances weigh the same however many songs they have.
    fn measure(dances: &Dances<Training>, columns: usize, config: &GptConfig) -> Self {
        let mut scale = Self {
            mean: vec![0.0; columns],
            spread: vec![1.0; columns],
        };
        if config.standardise_music {
            scale.standardise(dances);
        }
        if config.hear == Hear::Rhythm {
            scale
                .mute(|column| column < COLUMNS && column != ONSET_COLUMN && column != BEAT_COLUMN);
        }
        scale
    }

    /// That of a stage's checkpoint.
    pub(super) fn restore(saved: &Saved) -> Result<Self, String> {
        let column = |name| Ok::<_, String>(saved.tensor(name)?.data().to_vec());
        Ok(Self {
            mean: column("music.mean")?,
            spread: column("music.spread")?,
        })
    }

    /// Without some columns: they weigh nothing, here and when folded.
    fn mute(&mut self, is_muted: impl Fn(usize) -> bool) {
        for (column, spread) in self.spread.iter_mut().enumerate() {
            if is_muted(column) {
                *spread = MUTED;
            }
        }
    }

    fn standardise(&mut self, dances: &Dances<Training>) {
        let columns = self.mean.len();
        let (mut total, mut sums) = (0.0_f64, vec![[0.0_f64; 2]; columns]);
        for piece in dances.pieces() {
            let weight = 1.0 / piece.songs().len() as f64;
            for row in piece.songs().iter().flat_map(|song| song.phase(0).rows()) {
                total += weight;
                for ([sum, squares], &value) in sums.iter_mut().zip(row) {
                    *sum += weight * f64::from(value);
                    *squares += weight * f64::from(value) * f64::from(value);
                }
            }
        }
        for (column, [sum, squares]) in sums.into_iter().enumerate() {
            let mean = sum / total;
            let variance = (squares / total - mean * mean).max(0.0);
            self.mean[column] = mean as f32;
            self.spread[column] = (variance.sqrt() as f32).max(SMALLEST_SPREAD);
        }
    }

    /// A row as training sees it.
    pub(super) fn seen<'a>(&'a self, row: ArrayView1<'a, f32>) -> impl Iterator<Item = f32> + 'a {
        let scale = self.mean.iter().zip(&self.spread);
        row.into_iter()
            .zip(scale)
            .map(|(&value, (mean, &spread))| match spread {
                MUTED => 0.0,
                spread => (value - mean) / spread,
            })
    }

    /// The same map for rows that are not scaled: what is exported.
    pub(super) fn fold(&self, music: &Linear) -> Linear {
        let columns = self.mean.len();
        let weight = Tensor::from_fn(music.weight.shape().to_vec(), |flat| {
            match self.spread[flat % columns] {
                MUTED => 0.0,
                spread => music.weight.data()[flat] / spread,
            }
        });
        let bias = Tensor::from_fn(music.bias.shape().to_vec(), |channel| {
            let row = weight.data()[channel * columns..].iter().zip(&self.mean);
            music.bias.data()[channel] - row.map(|(weight, mean)| weight * mean).sum::<f32>()
        });
        Linear { weight, bias }
    }

    /// The opposite of [`MusicScale::fold`].
    fn unfold(&self, music: &Linear) -> Linear {
        let columns = self.mean.len();
        let bias = Tensor::from_fn(music.bias.shape().to_vec(), |channel| {
            let row = music.weight.data()[channel * columns..]
                .iter()
                .zip(&self.mean);
            music.bias.data()[channel] + row.map(|(weight, mean)| weight * mean).sum::<f32>()
        });
        let weight = Tensor::from_fn(music.weight.shape().to_vec(), |flat| {
            match self.spread[flat % columns] {
                MUTED => 0.0,
                spread => music.weight.data()[flat] * spread,
            }
        });
        Linear { weight, bias }
    }
}

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
        let crops = CropPlan {
            frames: (stage.block + 1) * FRAMES_PER_CODE,
            stride: stage.stride * FRAMES_PER_CODE,
            mirror: config.data.mirror,
        };
        let choices = set.training.music_choices(config.gpt_phases());
        let windows = Windows::new(crops, choices, config.run.seed ^ 2);
        if windows.len() == 0 {
            return Err(too_short);
        }
        let frozen = Trained::<A::InnerBackend>::read(config, device)?;
        let mut encode = |pieces: &[MotionPiece], mirror, phases: usize| {
            let wanted = Augmentation {
                mirror,
                phases,
                vectors: config.ablation.continuous,
            };
            Codes::encode(&frozen, pieces, wanted, device, output)
        };
        let data = &config.data;
        // A slip may be of any number of frames.
        let phases = match Slips::new(stage) {
            Some(_) => PHASES,
            None => {
                let pieces = set.training.pieces().iter();
                let drawn = pieces.map(|piece| piece.phases(config.gpt_phases()));
                drawn.max().unwrap_or(1)
            }
        };
        let codes = encode(set.training.pieces(), data.mirror, phases);
        let test_codes = set.test.as_ref();
        let test_codes = test_codes.map(|test| encode(test.pieces(), false, 1));
        let mut scale = MusicScale::measure(&set.training, columns, stage);
        let mut store = Store::default();
        let mut net = config
            .ablation
            .network(&random(config, columns), &mut store);
        if let Some(path) = init {
            let state = |message: String| TrainError::State {
                path: path.to_owned(),
                message,
            };
            match Saved::of_extension(path)? {
                Some(saved) => {
                    store = saved.fill(WEIGHT, &store).map_err(state)?;
                    scale = MusicScale::restore(&saved).map_err(state)?;
                }
                None => {
                    let checkpoint = &mut Checkpoint::open(path)?;
                    let mut weights = GptWeights::from_checkpoint(checkpoint, stage.heads)?;
                    weights.music = scale.unfold(&weights.music);
                    let mut found = Store::default();
                    net = config.ablation.network(&weights, &mut found);
                    if !found.fits(&store) {
                        let message = "is of other sizes than [gpt] and [vqvae] say";
                        return Err(state(message.into()));
                    }
                    store = found;
                }
            }
        }
        let plan = Plan {
            name: "gpt",
            run: &config.run,
            training: &stage.training,
            settings: set.settings(config, Stage::Gpt)?,
            store,
            windows: windows.len(),
        };
        let work = Self {
            config,
            set,
            windows,
            net,
            codes,
            test_codes,
            scale,
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
        let starts: BTreeSet<[i32; 2]> = self.codes.starts().collect();
        let values: Vec<f32> = starts.iter().flatten().map(|&code| code as f32).collect();
        let starts = Tensor::from_fn(vec![starts.len(), 2], |place| values[place]);
        saved.tensors.insert("start_codes".into(), starts);
    }

    fn restore(&mut self, saved: &Saved) -> Result<(), String> {
        self.scale = MusicScale::restore(saved)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folded_scale_gives_plain_rows_what_training_saw_and_muted_columns_nothing() {
        let mut scale = MusicScale {
            mean: vec![1.0, -2.0, 30.0],
            spread: vec![0.5, 4.0, 10.0],
        };
        scale.mute(|column| column == 2);
        let trained = Linear {
            weight: Tensor::from_fn(vec![2, 3], |flat| flat as f32 - 2.0),
            bias: Tensor::from_fn(vec![2], |channel| channel as f32),
        };
        let apply = |linear: &Linear, row: [f32; 3]| {
            [0, 1].map(|channel| {
                let weights = &linear.weight.data()[3 * channel..][..3];
                let sum: f32 = weights.iter().zip(row).map(|(weight, x)| weight * x).sum();
                linear.bias.data()[channel] + sum
            })
        };
        let folded = scale.fold(&trained);
        for row in [[0.0, 0.0, 0.0], [3.0, 1.0, -7.0], [3.0, 1.0, 900.0]] {
            let seen =
                [0, 1, 2].map(|column| (row[column] - scale.mean[column]) / scale.spread[column]);
            let (plain, wanted) = (apply(&folded, row), apply(&trained, seen));
            for (plain, wanted) in plain.into_iter().zip(wanted) {
                assert!((plain - wanted).abs() < 1e-4, "{plain} {wanted}");
            }
        }
        let back = scale.unfold(&folded);
        let heard =
            [0, 1, 3, 4].map(|flat| (back.weight.data()[flat], trained.weight.data()[flat]));
        assert!(
            heard
                .iter()
                .all(|(back, weight)| (back - weight).abs() < 1e-5),
            "{heard:?}"
        );
        assert_eq!(back.bias.data(), trained.bias.data());
        assert!([2, 5].iter().all(|&flat| folded.weight.data()[flat] == 0.0));
    }
}
