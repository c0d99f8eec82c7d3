//! Stage `gpt`: the next codes from codes and music, on frozen codes of both halves.

use std::path::Path;

use burn_tensor::{
    Int, Tensor as Device, TensorData, activation::log_softmax, backend::AutodiffBackend,
};

use super::{
    Config, FRAMES_PER_CODE, MotionSet, Stage, TrainError,
    keep::settings,
    runner::{Losses, Plan, Work},
    saved::Saved,
    vqvae::{Trained, half_crops},
    windows::{Window, Windows},
};
use crate::{
    Tensor,
    checkpoint::Checkpoint,
    nn::{GptNet, GptSizes, Parameters, Store, random_gpt},
    weights::{GptWeights, Linear},
};

/// Music columns that hardly move are not blown up beyond this.
const SMALLEST_SPREAD: f32 = 1e-3;

/// Mean and spread of each music column; training sees `(row - mean) / spread`.
#[derive(Clone, Debug)]
pub(super) struct MusicScale {
    pub(super) mean: Vec<f32>,
    pub(super) spread: Vec<f32>,
}

impl MusicScale {
    fn measure(set: &MotionSet, columns: usize, wanted: bool) -> Self {
        let mut scale = Self {
            mean: vec![0.0; columns],
            spread: vec![1.0; columns],
        };
        if !wanted {
            return scale;
        }
        for column in 0..columns {
            let (mut count, mut sum, mut squares) = (0.0_f64, 0.0_f64, 0.0_f64);
            for value in set.training().flat_map(|piece| piece.music.column(column)) {
                count += 1.0;
                sum += f64::from(*value);
                squares += f64::from(*value) * f64::from(*value);
            }
            let mean = sum / count;
            let variance = (squares / count - mean * mean).max(0.0);
            scale.mean[column] = mean as f32;
            scale.spread[column] = (variance.sqrt() as f32).max(SMALLEST_SPREAD);
        }
        scale
    }

    /// The same map for rows that are not scaled: what is exported.
    pub(super) fn fold(&self, music: &Linear) -> Linear {
        let columns = self.mean.len();
        let weight = Tensor::from_fn(music.weight.shape().to_vec(), |flat| {
            music.weight.data()[flat] / self.spread[flat % columns]
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
            music.weight.data()[flat] * self.spread[flat % columns]
        });
        Linear { weight, bias }
    }
}

pub(super) struct GptWork<'a, A: AutodiffBackend> {
    config: &'a Config,
    set: &'a MotionSet,
    windows: Windows,
    net: GptNet,
    /// Upper and lower codes of each training piece.
    codes: Vec<[Vec<i32>; 2]>,
    scale: MusicScale,
    device: A::Device,
}

/// A network of the configured size.
pub(super) fn random(config: &Config, columns: usize) -> GptWeights {
    let (gpt, codes) = (&config.gpt, config.vqvae.codes);
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

impl<'a, A: AutodiffBackend> GptWork<'a, A> {
    pub(super) fn new(
        config: &'a Config,
        set: &'a MotionSet,
        init: Option<&Path>,
        device: &A::Device,
    ) -> Result<(Plan<'a>, Self), TrainError> {
        let stage = &config.gpt;
        let too_short = TrainError::TooShort {
            length: stage.block + 1,
            unit: "codes",
        };
        let columns = set.training().next().map(|piece| piece.music.ncols());
        let Some(columns) = columns else {
            return Err(too_short);
        };
        let codes = encode::<A>(config, set, device)?;
        let rows = set.training().map(|piece| piece.music.nrows());
        let lengths = codes
            .iter()
            .zip(rows)
            .map(|([upper, _], rows)| upper.len().min(rows));
        let seed = config.run.seed ^ 2;
        let windows = Windows::new(lengths, stage.block + 1, stage.stride, seed);
        if windows.len() == 0 {
            return Err(too_short);
        }
        let scale = MusicScale::measure(set, columns, stage.standardise_music);
        let mut store = Store::default();
        let mut net = GptNet::new(&random(config, columns), &mut store);
        if let Some(path) = init {
            let checkpoint = &mut Checkpoint::open(path)?;
            let mut weights = GptWeights::from_checkpoint(checkpoint, stage.heads)?;
            weights.music = scale.unfold(&weights.music);
            let mut found = Store::default();
            net = GptNet::new(&weights, &mut found);
            let names = |store: &Store| -> Vec<(String, Vec<usize>)> {
                let entries = store.entries().iter();
                entries
                    .map(|(name, tensor)| (name.clone(), tensor.shape().to_vec()))
                    .collect()
            };
            if names(&found) != names(&store) {
                return Err(TrainError::State {
                    path: path.to_owned(),
                    message: "is of other sizes than [gpt] and [vqvae] say".into(),
                });
            }
            store = found;
        }
        let plan = Plan {
            name: "gpt",
            run: &config.run,
            training: &stage.training,
            settings: settings(config, Stage::Gpt)?,
            store,
            windows: windows.len(),
        };
        let work = Self {
            config,
            set,
            windows,
            net,
            codes,
            scale,
            device: device.clone(),
        };
        Ok((plan, work))
    }

    /// Codes beside the windows, `offset` behind their starts, `[batch, block]`.
    fn codes(&self, windows: &[Window], half: usize, offset: usize) -> Device<A, 2, Int> {
        let block = self.config.gpt.block;
        let values: Vec<i32> = windows
            .iter()
            .flat_map(|&(piece, start)| &self.codes[piece][half][start + offset..][..block])
            .copied()
            .collect();
        let shape = [windows.len(), block];
        Device::from_data(TensorData::new(values, shape), &self.device)
    }

    /// The row beside code `k` is row `k + 1` (ARCHITECTURE section 3).
    fn music(&self, windows: &[Window]) -> Device<A, 3> {
        let (block, columns) = (self.config.gpt.block, self.scale.mean.len());
        let pieces: Vec<_> = self.set.training().collect();
        let mut values = Vec::with_capacity(windows.len() * block * columns);
        for &(piece, start) in windows {
            for row in start + 1..start + 1 + block {
                let row = pieces[piece].music.row(row);
                let scale = self.scale.mean.iter().zip(&self.scale.spread);
                values.extend(
                    row.iter()
                        .zip(scale)
                        .map(|(x, (mean, spread))| (x - mean) / spread),
                );
            }
        }
        let shape = [windows.len(), block, columns];
        Device::from_data(TensorData::new(values, shape), &self.device)
    }
}

/// The codes of every training piece, encoded whole.
fn encode<A: AutodiffBackend>(
    config: &Config,
    set: &MotionSet,
    device: &A::Device,
) -> Result<Vec<[Vec<i32>; 2]>, TrainError> {
    let frozen = Trained::<A::InnerBackend>::read(config, device)?;
    let lengths = set.training().map(|piece| piece.motion.nrows());
    let pieces = lengths.enumerate().map(|(piece, frames)| {
        let frames = frames / FRAMES_PER_CODE * FRAMES_PER_CODE;
        [0, 1].map(|half| {
            if frames == 0 {
                return Vec::new();
            }
            let motion = half_crops(set, &[(piece, 0)], frames, half, device);
            let net = &frozen.halves.nets[half];
            let codes = net.encode(&frozen.parameters, &frozen.codebooks[half], motion);
            codes.into_data().iter::<i32>().collect()
        })
    });
    Ok(pieces.collect())
}

impl<A: AutodiffBackend> Work<A> for GptWork<'_, A> {
    const COLUMNS: &'static [&'static str] = &["loss", "upper", "lower"];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let stage = &self.config.gpt;
        let windows = self.windows.batch(step, stage.training.batch);
        let codes = [0, 1].map(|half| self.codes(&windows, half, 0));
        let music = self.music(&windows);
        let logits = self.net.forward(parameters, music, codes, stage.dropout);
        let entropy = |logits: Device<A, 3>, half| {
            let targets = self.codes(&windows, half, 1).unsqueeze_dim::<3>(2);
            log_softmax(logits, 2).gather(2, targets).mean().neg()
        };
        let (upper, lower) = (entropy(logits.upper, 0), entropy(logits.lower, 1));
        let loss = upper.clone() + lower.clone();
        let metrics = [loss.clone(), upper, lower].map(Device::inner);
        Losses {
            loss,
            metrics: metrics.into(),
        }
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
        let starts = self
            .codes
            .iter()
            .filter_map(|[upper, lower]| Some([*upper.first()? as f32, *lower.first()? as f32]));
        let mut starts: Vec<[f32; 2]> = starts.collect();
        starts.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
        starts.dedup();
        let values: Vec<f32> = starts.concat();
        let starts = Tensor::from_fn(vec![starts.len(), 2], |place| values[place]);
        saved.tensors.insert("start_codes".into(), starts);
    }

    fn restore(&mut self, saved: &Saved) -> Result<(), String> {
        self.scale.mean = saved.tensor("music.mean")?.data().to_vec();
        self.scale.spread = saved.tensor("music.spread")?.data().to_vec();
        Ok(())
    }
}
