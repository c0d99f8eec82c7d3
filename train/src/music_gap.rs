//! Whether a model hears: how much worse it foretells a recording's codes with other music than with
//! the right one (METRICS, "Music gap").

use std::{
    fmt,
    path::{Path, PathBuf},
};

use bailando::{
    CancelToken,
    model::{Gpt, Logits, ModelDirectory, ModelError, Steps},
};
use ndarray::{Array2, ArrayView2, Axis, Slice};
use serde::Serialize;

use crate::{
    data::{
        Dataset, FeatureCache, MusicLibrary, OpenOptions, Portion, Song, Split, SplitKind,
        crop_starts, rows_beside,
    },
    encode::{EncodeError, columns},
};

/// Counts of half a bar.
const HALF_BAR: f64 = 2.0;

/// What to measure.
#[derive(Clone, Debug)]
pub struct MusicGapOptions {
    /// Model directory.
    pub model: PathBuf,
    /// Data folder of any layout, with songs.
    pub data: PathBuf,
    /// Folder of the songs, where they are kept apart.
    pub audio: Option<PathBuf>,
    /// Folder of music features; none: the usual one.
    pub cache: Option<PathBuf>,
    /// Which split.
    pub split: Split,
}

/// Cross-entropies in nats a code, upper and lower half added up, true codes given before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct MusicGap {
    /// Pieces measured.
    pub pieces: usize,
    /// Codes of each half that were foretold with the right music.
    pub codes: usize,
    /// With the right music.
    pub right_music: f64,
    /// How much is added by a song of another dance.
    pub another_song: Option<f64>,
    /// How much is added when the music comes one count early.
    pub one_count: Option<f64>,
    /// How much is added when the music comes half a bar early.
    pub half_bar: Option<f64>,
}

impl fmt::Display for MusicGap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let gap = |gap: Option<f64>| gap.map_or("–".into(), |gap| format!("{gap:+.4}"));
        writeln!(f, "| music | cross-entropy a code, upper + lower |")?;
        writeln!(f, "|---|---|")?;
        writeln!(f, "| its own | {:.4} |", self.right_music)?;
        writeln!(
            f,
            "| a song of another dance | {} |",
            gap(self.another_song)
        )?;
        writeln!(f, "| its own, one count early | {} |", gap(self.one_count))?;
        writeln!(f, "| its own, half a bar early | {} |", gap(self.half_bar))?;
        let (pieces, codes) = (self.pieces, self.codes);
        writeln!(
            f,
            "\n{pieces} pieces, {codes} codes; a model that does not hear has gaps of 0."
        )
    }
}

/// Measures a model on the recordings and songs of a split, in windows of its whole block.
///
/// # Errors
/// [`EncodeError`]: the data, the model, or a recording that cannot be encoded.
pub fn music_gap(options: &MusicGapOptions) -> Result<MusicGap, EncodeError> {
    let open = OpenOptions {
        audio: options.audio.clone(),
    };
    let dataset = Dataset::open(&options.data, &open)?;
    match options.split {
        Split::Train => measure(&dataset.training()?, options),
        Split::Test => measure(&dataset.evaluation()?, options),
    }
}

/// A recording's codes beside one of its songs.
struct Pair {
    dance: usize,
    codes: [Vec<u32>; 2],
    rows: Array2<f32>,
    bpm: Option<f64>,
}

fn measure<S: SplitKind>(
    portion: &Portion<S>,
    options: &MusicGapOptions,
) -> Result<MusicGap, EncodeError> {
    let directory = ModelDirectory::open(&options.model)?;
    let pairs = pairs(portion, &directory, options.cache.as_deref())?;
    let manifest = directory.manifest();
    let rows_a_second = manifest.codes_per_second();
    let mut listener = Listener {
        gpt: directory.gpt(1)?,
        block: manifest.gpt.block,
    };
    let (mut right, mut gaps) = (Sum::default(), [Sum::default(); 3]);
    for (place, pair) in pairs.iter().enumerate() {
        let shifted = |counts: f64| {
            let seconds = counts * 60.0 / pair.bpm?;
            let rows = (seconds * rows_a_second).round() as usize;
            let from = Slice::from(rows.min(pair.rows.nrows())..);
            Some(pair.rows.slice_axis(Axis(0), from))
        };
        let (before, after) = pairs.split_at(place);
        // Two dancers of one take share their songs.
        let other = after
            .iter()
            .chain(before)
            .find(|other| other.dance != pair.dance && other.rows != pair.rows)
            .map(|other| other.rows.view());
        let variants = [other, shifted(1.0), shifted(HALF_BAR)];
        let own = listener.entropies(pair, pair.rows.view())?;
        own.iter().for_each(|&entropy| right.add(entropy));
        for (gap, rows) in gaps.iter_mut().zip(variants) {
            let Some(rows) = rows else { continue };
            let entropies = listener.entropies(pair, rows)?;
            for (entropy, own) in entropies.iter().zip(&own) {
                gap.add(entropy - own);
            }
        }
    }
    let [another_song, one_count, half_bar] = gaps.map(|gap| (gap.count > 0).then(|| gap.mean()));
    Ok(MusicGap {
        pieces: pairs.len(),
        codes: right.count,
        right_music: right.mean(),
        another_song,
        one_count,
        half_bar,
    })
}

fn pairs<S: SplitKind>(
    portion: &Portion<S>,
    directory: &ModelDirectory,
    cache: Option<&Path>,
) -> Result<Vec<Pair>, EncodeError> {
    let manifest = directory.manifest();
    let cache = FeatureCache::open_or_default(cache)?;
    let features = &manifest.features;
    let mut library =
        MusicLibrary::new(cache, features.profile).with_count_periods(&features.count_periods);
    let mut encoder = directory.encoder(1)?;
    let cancel = CancelToken::new();
    let mut pairs = Vec::new();
    for (place, dance) in portion.dances().iter().enumerate() {
        let motion = dance.motion(portion.skeleton())?;
        let columns = columns(&motion, manifest.motion_frame)?;
        let (upper, lower) = encoder.encode(columns.view(), &cancel)?;
        for song in dance.songs() {
            let Some(music) = &song.music else { continue };
            pairs.push(Pair {
                dance: place,
                codes: [upper.clone(), lower.clone()],
                rows: library.conditioning(music, 0)?,
                bpm: bpm(song),
            });
        }
    }
    if pairs.is_empty() {
        return Err(EncodeError::NoMusic);
    }
    Ok(pairs)
}

/// As the data say, else of its beats.
fn bpm(song: &Song) -> Option<f64> {
    let of_beats = || {
        let (first, last) = (song.grid_beats_s.first()?, song.grid_beats_s.last()?);
        Some(60.0 * (song.grid_beats_s.len() - 1) as f64 / (last - first))
    };
    let bpm = song.bpm.or_else(of_beats);
    bpm.filter(|bpm| bpm.is_finite() && *bpm > 0.0)
}

struct Listener {
    gpt: Gpt,
    block: usize,
}

impl Listener {
    /// Of every code that windows of the whole block foretell, as far as rows go.
    fn entropies(
        &mut self,
        pair: &Pair,
        rows: ArrayView2<'_, f32>,
    ) -> Result<Vec<f64>, ModelError> {
        let (block, cancel) = (self.block, CancelToken::new());
        let [upper, lower] = &pair.codes;
        // A window's last code is foretold only, and needs no row.
        let codes = upper
            .len()
            .saturating_sub(1)
            .min(rows.nrows().saturating_sub(1));
        let mut entropies = Vec::new();
        for start in crop_starts(codes, block, block) {
            let window = start..start + block;
            let targets = start + 1..start + block + 1;
            let steps = Steps {
                upper: &upper[window.clone()],
                lower: &lower[window.clone()],
                music: rows.slice_axis(Axis(0), Slice::from(rows_beside(window))),
            };
            let mut cache = self.gpt.empty_cache()?;
            let Logits {
                upper: upper_logits,
                lower: lower_logits,
            } = self.gpt.run(steps, &mut cache, &cancel)?;
            let halves = [
                (upper_logits, &upper[targets.clone()]),
                (lower_logits, &lower[targets]),
            ];
            let [upper, lower] = halves.map(|(logits, codes)| cross_entropies(&logits, codes));
            entropies.extend(upper.iter().zip(lower).map(|(upper, lower)| upper + lower));
        }
        Ok(entropies)
    }
}

/// `-log p(code)` by row.
fn cross_entropies(logits: &Array2<f32>, codes: &[u32]) -> Vec<f64> {
    let rows = logits.rows().into_iter().zip(codes);
    rows.map(|(row, &code)| {
        let highest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let below = |value: f32| f64::from(value - highest);
        let total: f64 = row.iter().map(|&value| below(value).exp()).sum();
        total.ln() - below(row[code as usize])
    })
    .collect()
}

#[derive(Clone, Copy, Default)]
struct Sum {
    total: f64,
    count: usize,
}

impl Sum {
    fn add(&mut self, value: f64) {
        self.total += value;
        self.count += 1;
    }

    fn mean(self) -> f64 {
        self.total / self.count.max(1) as f64
    }
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
