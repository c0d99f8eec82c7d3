//! How music columns are scaled for the GPT.

use bailando::features::{BEAT_COLUMN, COLUMNS, ONSET_COLUMN};
use ndarray::ArrayView1;

use super::{
    checkpoint::Checkpoint,
    config::{GptConfig, MusicColumns},
    input::Motions,
};
use crate::{HostTensor, data::Training, weights::Linear};

/// Smallest spread: columns that hardly move are not amplified further.
const SMALLEST_SPREAD: f32 = 1e-3;

/// The spread of a column that is left out: the largest that can be saved.
const MUTED: f32 = f32::MAX;

/// Names in checkpoints.
const MEAN: &str = "music.mean";
const SPREAD: &str = "music.spread";

/// Mean and spread of each music column; training sees `(row - mean) / spread`.
#[derive(Clone, Debug)]
pub(super) struct MusicScale {
    pub(super) mean: Vec<f32>,
    pub(super) spread: Vec<f32>,
}

impl MusicScale {
    /// Measures the first phase of all songs; a motion has one weight, however many songs it has.
    pub(super) fn measure(motions: &Motions<Training>, columns: usize, config: &GptConfig) -> Self {
        let mut scale = Self::plain(columns);
        if config.standardise_music {
            scale.standardise(motions);
        }
        scale.mute(|column| is_muted(config.music_columns, column));
        scale
    }

    /// The scale that leaves every column as it is.
    pub(super) fn plain(columns: usize) -> Self {
        Self { mean: vec![0.0; columns], spread: vec![1.0; columns] }
    }

    /// Adds the scale to a checkpoint.
    pub(super) fn save(&self, checkpoint: &mut Checkpoint) {
        checkpoint.put_vector(MEAN, &self.mean);
        checkpoint.put_vector(SPREAD, &self.spread);
    }

    /// Reads the scale of a stage's checkpoint.
    pub(super) fn restore(checkpoint: &Checkpoint) -> Result<Self, String> {
        let column = |name| Ok::<_, String>(checkpoint.tensor(name)?.data().to_vec());
        Ok(Self { mean: column(MEAN)?, spread: column(SPREAD)? })
    }

    /// Reads the scale of another run's checkpoint, if that run had the same `hear` and
    /// `standardise_music`: the manifest states the settings, and weights of a muted column mean
    /// nothing.
    pub(super) fn restore_for(config: &GptConfig, checkpoint: &Checkpoint) -> Result<Self, String> {
        let scale = Self::restore(checkpoint)?;
        let muted = scale.spread.iter().map(|&spread| spread == MUTED);
        let wanted = (0..scale.spread.len()).map(|column| is_muted(config.music_columns, column));
        if !muted.eq(wanted) {
            return Err(other_scale("hear"));
        }
        if scale.is_standardised() != config.standardise_music {
            return Err(other_scale("standardise_music"));
        }
        Ok(scale)
    }

    /// Whether columns are scaled by the training's mean and spread.
    pub(super) fn is_standardised(&self) -> bool {
        let moved = self.mean.iter().any(|&mean| mean != 0.0);
        moved || self.spread.iter().any(|&spread| ![1.0, MUTED].contains(&spread))
    }

    /// Leaves columns out: they have no weight, here and when folded.
    fn mute(&mut self, is_muted: impl Fn(usize) -> bool) {
        for (column, spread) in self.spread.iter_mut().enumerate() {
            if is_muted(column) {
                *spread = MUTED;
            }
        }
    }

    fn standardise(&mut self, motions: &Motions<Training>) {
        let columns = self.mean.len();
        let (mut total, mut sums) = (0.0_f64, vec![[0.0_f64; 2]; columns]);
        // Columns of the manner follow, which stay as they are.
        let mut measured = 0;
        for piece in motions.pieces() {
            let weight = 1.0 / piece.songs().len() as f64;
            for row in piece.songs().iter().flat_map(|song| song.phase(0).rows()) {
                total += weight;
                measured = row.len();
                for ([sum, squares], &value) in sums.iter_mut().zip(row) {
                    *sum += weight * f64::from(value);
                    *squares += weight * f64::from(value) * f64::from(value);
                }
            }
        }
        for (column, [sum, squares]) in sums.into_iter().take(measured).enumerate() {
            let mean = sum / total;
            let variance = (squares / total - mean * mean).max(0.0);
            self.mean[column] = mean as f32;
            self.spread[column] = (variance.sqrt() as f32).max(SMALLEST_SPREAD);
        }
    }

    /// Scales a row as training sees it.
    pub(super) fn scaled<'a>(&'a self, row: ArrayView1<'a, f32>) -> impl Iterator<Item = f32> + 'a {
        let scale = self.mean.iter().zip(&self.spread);
        row.into_iter().zip(scale).map(|(&value, (mean, &spread))| match spread {
            MUTED => 0.0,
            spread => (value - mean) / spread,
        })
    }

    /// Returns the same map for unscaled rows, for the export.
    pub(super) fn fold(&self, music: &Linear) -> Linear {
        let columns = self.mean.len();
        let weight = HostTensor::from_fn(music.weight.shape().to_vec(), |flat| {
            match self.spread[flat % columns] {
                MUTED => 0.0,
                spread => music.weight.data()[flat] / spread,
            }
        });
        let bias = HostTensor::from_fn(music.bias.shape().to_vec(), |channel| {
            let row = weight.data()[channel * columns..].iter().zip(&self.mean);
            music.bias.data()[channel] - row.map(|(weight, mean)| weight * mean).sum::<f32>()
        });
        Linear { weight, bias }
    }

    /// Reverses [`MusicScale::fold`].
    pub(super) fn unfold(&self, music: &Linear) -> Linear {
        let columns = self.mean.len();
        let bias = HostTensor::from_fn(music.bias.shape().to_vec(), |channel| {
            let row = music.weight.data()[channel * columns..].iter().zip(&self.mean);
            music.bias.data()[channel] + row.map(|(weight, mean)| weight * mean).sum::<f32>()
        });
        let weight = HostTensor::from_fn(music.weight.shape().to_vec(), |flat| {
            match self.spread[flat % columns] {
                MUTED => 0.0,
                spread => music.weight.data()[flat] * spread,
            }
        });
        Linear { weight, bias }
    }
}

/// Whether a column of the music is left out. The places within a count come after the features.
fn is_muted(columns: MusicColumns, column: usize) -> bool {
    match columns {
        MusicColumns::All => false,
        MusicColumns::Rhythm => column < COLUMNS && ![ONSET_COLUMN, BEAT_COLUMN].contains(&column),
    }
}

fn other_scale(setting: &str) -> String {
    format!("was trained with another gpt.{setting} than the settings say: give it the same")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::Config;

    #[test]
    fn a_folded_scale_gives_plain_rows_what_training_saw_and_muted_columns_nothing() {
        let mut scale = MusicScale { mean: vec![1.0, -2.0, 30.0], spread: vec![0.5, 4.0, 10.0] };
        scale.mute(|column| column == 2);
        let trained = Linear {
            weight: HostTensor::from_fn(vec![2, 3], |flat| flat as f32 - 2.0),
            bias: HostTensor::from_fn(vec![2], |channel| channel as f32),
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
        let kept = [0, 1, 3, 4].map(|flat| (back.weight.data()[flat], trained.weight.data()[flat]));
        assert!(kept.iter().all(|(back, weight)| (back - weight).abs() < 1e-5), "{kept:?}");
        assert_eq!(back.bias.data(), trained.bias.data());
        assert!([2, 5].iter().all(|&flat| folded.weight.data()[flat] == 0.0));
    }

    fn checkpoint(spread: [f32; 2], mean: [f32; 2]) -> Checkpoint {
        let mut checkpoint = Checkpoint::default();
        checkpoint.put_vector(MEAN, &mean);
        checkpoint.put_vector(SPREAD, &spread);
        checkpoint
    }

    #[test]
    fn a_saved_scale_must_be_what_the_settings_say() {
        let mut config = Config::parse("").unwrap().gpt;
        let restored = |config: &GptConfig, checkpoint: &Checkpoint| {
            MusicScale::restore_for(config, checkpoint)
        };
        let (plain, muted) = (checkpoint([1.0; 2], [0.0; 2]), checkpoint([MUTED; 2], [0.0; 2]));
        let scaled = checkpoint([0.5, 2.0], [3.0, 0.0]);
        assert!(restored(&config, &plain).is_ok());
        assert!(restored(&config, &muted).unwrap_err().contains("gpt.hear"));
        let refused = restored(&config, &scaled).unwrap_err();
        assert!(refused.contains("gpt.standardise_music"), "{refused}");

        config.standardise_music = true;
        assert_eq!(restored(&config, &scaled).unwrap().mean, [3.0, 0.0]);
        assert!(restored(&config, &plain).is_err());

        config.music_columns = MusicColumns::Rhythm;
        let refused = restored(&config, &scaled).unwrap_err();
        assert!(refused.contains("gpt.hear"), "{refused}");
        assert!(restored(&config, &checkpoint([MUTED; 2], [3.0, 0.0])).is_ok());
        config.standardise_music = false;
        assert!(restored(&config, &muted).is_ok());
    }
}
