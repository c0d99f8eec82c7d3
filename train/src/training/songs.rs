//! Feature rows of all songs that a stage needs, from the cache or computed side by side.

use std::{
    collections::{BTreeMap, HashMap},
    io::Write,
    sync::Arc,
};

use bailando::model::CountSource;
use ndarray::Array2;
use rayon::prelude::*;
use sha2::{Digest, Sha256};

use super::{config::DataConfig, error::TrainError};
use crate::data::{
    DataError, FeatureCache, KnownCounts, MusicLibrary, MusicSource, Portion, Recording, Training,
};

/// Conditioning rows of a song, row `k` at frame `8 k`, for each start phase from 0 on.
#[derive(Clone, Debug)]
pub struct SongRows(Vec<Arc<Array2<f32>>>);

impl SongRows {
    /// Takes `[rows, columns]` of the whole song, then of the song without its first frame, and so
    /// on; one entry for a song that cannot be moved. None without any.
    #[must_use]
    pub fn new(phases: Vec<Arc<Array2<f32>>>) -> Option<Self> {
        (!phases.is_empty()).then_some(Self(phases))
    }

    /// Rows of the song without its first `phase` frames, which must be among those known.
    pub(super) fn phase(&self, phase: usize) -> &Array2<f32> {
        &self.0[phase]
    }

    /// Returns the number of start phases known.
    pub(super) fn phases(&self) -> usize {
        self.0.len()
    }
}

/// Rows by song.
pub(super) type MusicRows = HashMap<MusicSource, SongRows>;

/// Songs between two lines of progress.
const SONGS_A_LINE: usize = 16;

/// The cache that the settings name.
pub(super) fn feature_cache(data: &DataConfig) -> Result<FeatureCache, TrainError> {
    Ok(FeatureCache::open_or_default(data.cache_folder())?)
}

/// What computes features as the settings say, with counts that are known.
pub(super) fn music_library(
    data: &DataConfig,
    cache: FeatureCache,
    known: &Arc<KnownCounts>,
) -> MusicLibrary {
    MusicLibrary::new(cache, data.profile)
        .with_count_periods(&data.count_periods, data.counts)
        .with_known_counts(Arc::clone(known))
}

/// The counts of training songs by the data's own beats. Left out is the share of the songs that
/// learn from the tracker's counts, as in serving. With librosa all songs do: its counts are late
/// by a constant, and a model learns either those or the data's.
pub(super) fn known_counts(data: &DataConfig, portion: &Portion<Training>) -> Arc<KnownCounts> {
    if data.counts == CountSource::Librosa || data.count_periods.is_empty() {
        return Arc::default();
    }
    let counts = portion.recordings().iter().flat_map(Recording::known_counts);
    let is_heard = |music: &MusicSource| {
        let name = music.path().file_name().unwrap_or_default();
        share_of(name.as_encoded_bytes()) < data.heard_counts
    };
    let told = counts.filter(|(music, _)| !is_heard(music));
    Arc::new(told.map(|(music, counts)| (music.clone(), counts)).collect())
}

/// Returns a number from 0 to 1 that a name has for good, evenly spread.
fn share_of(name: &[u8]) -> f64 {
    let digest = Sha256::digest(name);
    let number = digest.iter().take(4).fold(0_u32, |number, &byte| number << 8 | u32::from(byte));
    f64::from(number) / f64::from(u32::MAX)
}

/// Rows of each of `wanted` for that many start phases, or for one where the song cannot be moved.
pub(super) fn song_rows(
    data: &DataConfig,
    wanted: Vec<(MusicSource, usize)>,
    known: &Arc<KnownCounts>,
    output: &mut impl Write,
) -> Result<MusicRows, TrainError> {
    let mut songs: BTreeMap<MusicSource, usize> = BTreeMap::new();
    for (song, phases) in wanted {
        let phases = if song.can_shift() { phases } else { 1 };
        let most = songs.entry(song).or_insert(phases);
        *most = phases.max(*most);
    }
    let cache = feature_cache(data)?;
    let songs: Vec<(MusicSource, usize)> = songs.into_iter().collect();
    let mut rows = MusicRows::new();
    let mut computed = 0;
    for some in songs.chunks(SONGS_A_LINE) {
        let library = || music_library(data, cache.clone(), known);
        let found = some.par_iter().map_init(library, |library, (song, phases)| {
            let before = library.computed();
            let rows = library.phases(song, *phases)?;
            Ok((rows, library.computed() - before))
        });
        let found: Vec<Result<_, DataError>> = found.collect();
        for ((song, _), found) in some.iter().zip(found) {
            let (phases, new) = found?;
            computed += new;
            let song_rows = SongRows::new(phases.into_iter().map(Arc::new).collect());
            rows.extend(song_rows.map(|song_rows| (song.clone(), song_rows)));
        }
        if computed > 0 {
            // Progress that cannot be shown is no reason to stop.
            let _ = writeln!(output, "music of {}/{} songs", rows.len(), songs.len());
        }
    }
    Ok(rows)
}
