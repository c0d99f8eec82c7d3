//! Recordings' codes beside their songs, and a model's predictions of them.

use std::path::{Path, PathBuf};

use bailando::model::{
    Gpt, Logits, Manner, MannerSpec, ModelDirectory, ModelError, Steps, code_pairs,
};
use clap::Args;
use ndarray::{Array2, ArrayView2, Axis, Slice};

use crate::{
    data::{
        Dataset, FeatureCache, MusicLibrary, OpenOptions, Portion, Song, Split, SplitKind,
        crop_starts, rows_beside,
    },
    encode::{EncodeError, columns},
};

/// The recordings of a data folder that models predict.
#[derive(Args, Clone, Debug)]
pub struct Recordings {
    /// Data folder of any layout, with songs
    #[arg(skip)]
    pub data: PathBuf,
    /// Folder of the songs, where they are kept apart from the motions
    #[arg(long, value_name = "DIR")]
    pub audio: Option<PathBuf>,
    /// Folder of music features [default: the user's cache]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Which recordings
    #[arg(long, value_enum, default_value_t = Split::Test)]
    pub split: Split,
}

impl Recordings {
    pub(crate) fn open(&self) -> Result<Dataset, EncodeError> {
        let open = OpenOptions { audio: self.audio.clone() };
        Ok(Dataset::open(&self.data, &open)?)
    }
}

/// A recording's codes beside one of its songs.
pub(crate) struct Pair {
    pub(crate) dance: usize,
    pub(crate) codes: [Vec<u32>; 2],
    pub(crate) rows: Array2<f32>,
    /// The recording's style, where the model knows it.
    pub(crate) manner: Manner,
    pub(crate) bpm: Option<f64>,
}

/// Returns all pairs of a portion, with the model's codes and music rows.
pub(crate) fn pairs<S: SplitKind>(
    portion: &Portion<S>,
    directory: &ModelDirectory,
    cache: Option<&Path>,
) -> Result<Vec<Pair>, EncodeError> {
    let manifest = directory.manifest();
    let cache = FeatureCache::open_or_default(cache)?;
    let features = &manifest.features;
    let mut library = MusicLibrary::new(cache, features.profile)
        .with_count_periods(&features.count_periods, features.counts)
        .with_counts_later(features.counts_late_s);
    let mut encoder = directory.encoder(1)?;
    let mut pairs = Vec::new();
    for (place, dance) in portion.recordings().iter().enumerate() {
        let motion = dance.motion(portion.skeleton())?;
        let columns = columns(&motion, manifest.motion_frame)?;
        let codes = encoder.encode(columns.view())?;
        let style = dance.marks().style.as_ref();
        let style = manifest.styles.iter().position(|known| Some(known) == style);
        let half = |half: usize| codes.iter().map(|pair| pair[half]).collect::<Vec<_>>();
        for song in dance.songs() {
            let Some(music) = &song.music else { continue };
            pairs.push(Pair {
                dance: place,
                codes: [half(0), half(1)],
                rows: library.conditioning(music, 0)?,
                manner: Manner { style, energy: None },
                bpm: bpm(song),
            });
        }
    }
    if pairs.is_empty() {
        return Err(EncodeError::NoMusic);
    }
    Ok(pairs)
}

/// Returns the tempo of the data, else that of the beats.
fn bpm(song: &Song) -> Option<f64> {
    let of_beats = || {
        let (first, last) = (song.grid_beats_s.first()?, song.grid_beats_s.last()?);
        Some(60.0 * (song.grid_beats_s.len() - 1) as f64 / (last - first))
    };
    let bpm = song.bpm.or_else(of_beats);
    bpm.filter(|bpm| bpm.is_finite() && *bpm > 0.0)
}

/// Scores of a window's codes, and the true upper and lower codes.
pub(crate) type Prediction<'pair> = (Logits, [&'pair [u32]; 2]);

/// Predicts codes from the true ones before them, in windows of the whole block.
pub(crate) struct Predictor {
    gpt: Gpt,
    block: usize,
    manners: MannerSpec,
}

impl Predictor {
    pub(crate) fn open(directory: &ModelDirectory) -> Result<Self, ModelError> {
        let manifest = directory.manifest();
        let (block, manners) = (manifest.gpt.block, manifest.manners());
        Ok(Self { gpt: directory.gpt(1)?, block, manners })
    }

    /// Returns the scores of every window that has rows, beside the true codes.
    pub(crate) fn predicted<'pair>(
        &mut self,
        pair: &'pair Pair,
        rows: ArrayView2<'_, f32>,
    ) -> Result<Vec<Prediction<'pair>>, ModelError> {
        let block = self.block;
        let [upper, lower] = &pair.codes;
        let rows = self.manners.beside(rows, pair.manner);
        // A window's last code is only predicted, and needs no row.
        let codes = upper.len().saturating_sub(1).min(rows.nrows().saturating_sub(1));
        let windows = crop_starts(codes, block, block).map(|start| {
            let window = start..start + block;
            let targets = start + 1..start + block + 1;
            let steps = Steps {
                codes: &code_pairs(&upper[window.clone()], &lower[window.clone()])?,
                music: rows.slice_axis(Axis(0), Slice::from(rows_beside(window))),
            };
            let logits = self.gpt.logits(steps)?;
            Ok((logits, [&upper[targets.clone()], &lower[targets]]))
        });
        windows.collect()
    }

    /// Returns the cross-entropy of every predicted code, upper + lower.
    pub(crate) fn entropies(
        &mut self,
        pair: &Pair,
        rows: ArrayView2<'_, f32>,
    ) -> Result<Vec<f64>, ModelError> {
        let windows = self.predicted(pair, rows)?.into_iter();
        let entropies = windows.flat_map(|(logits, [upper, lower])| {
            let upper = cross_entropies(&logits.upper, upper);
            let lower = cross_entropies(&logits.lower, lower);
            upper.into_iter().zip(lower).map(|(upper, lower)| upper + lower)
        });
        Ok(entropies.collect())
    }
}

/// `-log p(code)` by row.
pub(crate) fn cross_entropies(logits: &Array2<f32>, codes: &[u32]) -> Vec<f64> {
    let rows = logits.rows().into_iter().zip(codes);
    rows.map(|(row, &code)| {
        let highest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let below = |value: f32| f64::from(value - highest);
        let total: f64 = row.iter().map(|&value| below(value).exp()).sum();
        total.ln() - below(row[code as usize])
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_logits_cost_the_logarithm_of_the_vocabulary() {
        let logits = Array2::from_elem((2, 8), 3.0);
        for entropy in cross_entropies(&logits, &[0, 7]) {
            assert!((entropy - 8_f64.ln()).abs() < 1e-12);
        }
        let sure = Array2::from_shape_vec((1, 2), vec![100.0, 0.0]).unwrap();
        assert!(cross_entropies(&sure, &[0])[0] < 1e-9);
        assert!((cross_entropies(&sure, &[1])[0] - 100.0).abs() < 1e-9);
    }
}
