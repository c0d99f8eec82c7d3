//! Conditioning on the music: how much worse a model predicts a recording's codes with other music
//! than with the right one (METRICS, "Music gap").

use std::{fmt, path::PathBuf};

use bailando::model::ModelDirectory;
use clap::Args;
use ndarray::{Axis, Slice};
use serde::Serialize;

use crate::{
    data::{Portion, Split, SplitKind},
    encode::EncodeError,
    held_out::{Predictor, Recordings, pairs},
};

/// Beats of half a bar.
const HALF_BAR: f64 = 2.0;

/// What to measure.
#[derive(Args, Clone, Debug)]
pub struct MusicGapOptions {
    /// Model directory
    #[arg(long = "model-dir", default_value = "models/default", value_name = "DIR")]
    pub model: PathBuf,
    /// The recordings that it predicts.
    #[command(flatten)]
    pub recordings: Recordings,
}

/// Cross-entropies in nats a code, upper and lower half added up, true codes given before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct MusicGap {
    /// Pieces measured.
    pub pieces: usize,
    /// Codes of each half that were predicted with the right music.
    pub codes: usize,
    /// With the right music.
    pub right_music: f64,
    /// How much is added by a song of another dance.
    pub another_song: Option<f64>,
    /// How much is added when the music comes one count early.
    pub one_count: Option<f64>,
    /// How much is added when the music comes half a bar early.
    pub half_bar: Option<f64>,
    /// How much is added when the music comes half a count early: where a beat of the data is two
    /// counts of the dancer, one of these.
    pub half_count: Option<f64>,
}

impl fmt::Display for MusicGap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let gap = |gap: Option<f64>| gap.map_or("–".into(), |gap| format!("{gap:+.4}"));
        writeln!(f, "| music | cross-entropy a code, upper + lower |")?;
        writeln!(f, "|---|---|")?;
        writeln!(f, "| its own | {:.4} |", self.right_music)?;
        writeln!(f, "| a song of another dance | {} |", gap(self.another_song))?;
        writeln!(f, "| its own, half a count early | {} |", gap(self.half_count))?;
        writeln!(f, "| its own, one count early | {} |", gap(self.one_count))?;
        writeln!(f, "| its own, half a bar early | {} |", gap(self.half_bar))?;
        let (pieces, codes) = (self.pieces, self.codes);
        writeln!(
            f,
            "\n{pieces} pieces, {codes} codes; a model that ignores the music has gaps of 0."
        )
    }
}

/// Measures a model on the recordings and songs of a split, in windows of its whole block.
///
/// # Errors
/// [`EncodeError`]: the data, the model, or a recording that cannot be encoded.
pub fn music_gap(options: &MusicGapOptions) -> Result<MusicGap, EncodeError> {
    let dataset = options.recordings.open()?;
    match options.recordings.split {
        Split::Train => measure(&dataset.training()?, options),
        Split::Test => measure(&dataset.evaluation()?, options),
    }
}

fn measure<S: SplitKind>(
    portion: &Portion<S>,
    options: &MusicGapOptions,
) -> Result<MusicGap, EncodeError> {
    let directory = ModelDirectory::open(&options.model)?;
    let pairs = pairs(portion, &directory, options.recordings.cache.as_deref())?;
    let manifest = directory.manifest();
    let rows_a_second = manifest.codes_per_second();
    let mut predictor = Predictor::open(&directory)?;
    let (mut right, mut gaps) = (Sum::default(), [Sum::default(); 4]);
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
        let variants = [other, shifted(1.0), shifted(HALF_BAR), shifted(0.5)];
        let own = predictor.entropies(pair, pair.rows.view())?;
        own.iter().for_each(|&entropy| right.add(entropy));
        for (gap, rows) in gaps.iter_mut().zip(variants) {
            let Some(rows) = rows else { continue };
            let entropies = predictor.entropies(pair, rows)?;
            for (entropy, own) in entropies.iter().zip(&own) {
                gap.add(entropy - own);
            }
        }
    }
    let [another_song, one_count, half_bar, half_count] =
        gaps.map(|gap| (gap.count > 0).then(|| gap.mean()));
    Ok(MusicGap {
        pieces: pairs.len(),
        codes: right.count,
        right_music: right.mean(),
        another_song,
        one_count,
        half_bar,
        half_count,
    })
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
