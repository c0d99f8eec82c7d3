//! A model directory whose weights a run begins with (`--init DIR`), with room for more codes and
//! for styles.

use std::path::{Path, PathBuf};

use super::{config::Config, error::TrainError, served::ServedModel};
use crate::{
    HostTensor,
    export::ENCODER_FILE,
    onnx::GraphWeights,
    weights::{
        DecoderWeights, GptWeights, HalfWeights, Linear, MotionWeights, VqVaeWeights,
        encoders_from_graph,
    },
};

/// Weights to begin with.
pub(super) struct BaseModel {
    path: PathBuf,
    gpt: GptWeights,
    vqvae: VqVaeWeights,
    styles: Vec<String>,
}

impl BaseModel {
    /// Reads a model directory that this program has written, for a run of these settings.
    pub(super) fn open(config: &Config, path: &Path) -> Result<Self, TrainError> {
        let model = ServedModel::open(path)?;
        let (manifest, data) = (model.manifest(), &config.data);
        let other = [
            ("data.frame", manifest.motion_frame != data.frame),
            ("data.count_periods", manifest.features.count_periods != data.count_periods),
            ("data.profile", manifest.features.profile != data.profile),
        ];
        if let Some((setting, _)) = other.into_iter().find(|(_, differs)| *differs) {
            return Err(refused(path, &format!("was trained with another {setting}")));
        }
        let MotionWeights { codebooks, halves, root } = model.motion().clone();
        let Some(root) = root else {
            return Err(refused(path, "has no decoder of the root's velocity"));
        };
        let graph = &mut GraphWeights::open(&path.join(ENCODER_FILE))?;
        let [upper, lower] = encoders_from_graph(graph, &codebooks)?;
        let [upper_codes, lower_codes] = codebooks;
        let [upper_decoder, lower_decoder] = halves;
        let half = |encoder, codebook, decoder| HalfWeights { encoder, codebook, decoder };
        Ok(Self {
            path: path.to_owned(),
            gpt: model.gpt().clone(),
            vqvae: VqVaeWeights {
                upper: half(upper, upper_codes, upper_decoder),
                lower: half(lower, lower_codes, lower_decoder),
                root,
            },
            styles: manifest.styles.clone(),
        })
    }

    /// Number of codes that it knows.
    pub(super) fn codes(&self) -> usize {
        self.vqvae.upper.codebook.dim(0)
    }

    /// Returns its VQ-VAE with codebooks of `codes` entries; those beyond its own repeat them.
    pub(super) fn vqvae(&self, codes: usize) -> Result<VqVaeWeights, TrainError> {
        if codes < self.codes() {
            let most = self.codes();
            return Err(refused(&self.path, &format!("has {most} codes: vqvae.codes is less")));
        }
        let mut weights = self.vqvae.clone();
        for codebook in [&mut weights.upper.codebook, &mut weights.lower.codebook] {
            let rows: Vec<usize> = (0..codes).map(|code| code % codebook.dim(0)).collect();
            *codebook = chosen(codebook, &rows);
        }
        Ok(weights)
    }

    /// Returns its decoder of the root's velocity.
    pub(super) fn root(&self) -> &DecoderWeights {
        &self.vqvae.root
    }

    /// Returns its GPT for the codes of the run and rows of `columns`.
    ///
    /// A code beyond its own begins as what it knows of the nearest of its own. Columns for styles
    /// that it has not count for nothing at first.
    pub(super) fn gpt(
        &self,
        codebooks: [&HostTensor; 2],
        columns: usize,
        styles: &[String],
    ) -> Result<GptWeights, TrainError> {
        if !self.styles.is_empty() && self.styles != styles {
            return Err(refused(&self.path, "was trained with other styles"));
        }
        let [upper, lower] = codebooks.map(|codebook| nearest_known(codebook, self.codes()));
        let gpt = &self.gpt;
        Ok(GptWeights {
            music: widened(&gpt.music, columns),
            upper_embedding: chosen(&gpt.upper_embedding, &upper),
            lower_embedding: chosen(&gpt.lower_embedding, &lower),
            upper_head: chosen(&gpt.upper_head, &upper),
            lower_head: chosen(&gpt.lower_head, &lower),
            ..gpt.clone()
        })
    }
}

fn refused(path: &Path, message: &str) -> TrainError {
    TrainError::State { path: path.to_owned(), message: message.to_owned() }
}

/// Returns these rows of a matrix, in this order.
fn chosen(table: &HostTensor, rows: &[usize]) -> HostTensor {
    let rows: Vec<_> = rows.iter().map(|&row| table.rows(row, row + 1)).collect();
    HostTensor::stacked(&rows.iter().collect::<Vec<_>>())
}

/// Returns each entry's own place, and for entries from `known` on that of the nearest before.
fn nearest_known(codebook: &HostTensor, known: usize) -> Vec<usize> {
    let entry = |code: usize| codebook.data()[code * codebook.dim(1)..][..codebook.dim(1)].iter();
    let distance = |code: usize, other: usize| {
        entry(code).zip(entry(other)).map(|(a, b)| (a - b) * (a - b)).sum::<f32>()
    };
    let nearest = |code: usize| {
        let known = (0..known.min(codebook.dim(0))).map(|other| (distance(code, other), other));
        known.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(code, |(_, other)| other)
    };
    let codes = 0..codebook.dim(0);
    codes.map(|code| if code < known { code } else { nearest(code) }).collect()
}

/// The map with columns more, whose weights are zero.
fn widened(music: &Linear, columns: usize) -> Linear {
    let own = music.weight.transposed();
    let more = columns.saturating_sub(own.dim(0));
    let zeros = HostTensor::from_fn(vec![more, own.dim(1)], |_| 0.0);
    let weight = HostTensor::stacked(&[&own, &zeros]).transposed();
    Linear { weight, bias: music.bias.clone() }
}
