//! Feature rows of songs: computed by `bailando`, cached by content.

use std::{
    collections::HashMap,
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use bailando::{
    features::{
        BEAT_COLUMN, BeatPhase, Beats, COLUMNS, FeatureExtractor, HOP, Profile, Rate, with_counts,
    },
    model::CountSource,
};
use ndarray::Array2;

use super::{
    DataError, FPS, FeatureCache, FeatureKey, MusicSource, audio::decoded, files, json,
    tracker::BeatTracker,
};

/// Computes, caches and hands out music rows of one profile.
pub struct MusicLibrary {
    cache: FeatureCache,
    profile: Profile,
    extractors: HashMap<u32, FeatureExtractor>,
    computed: usize,
    count_periods: Vec<u32>,
    counts_late_s: f64,
    counts: CountSource,
    network: BeatTracker,
    known: Arc<KnownCounts>,
}

/// Counts of songs whose beats the data say.
pub type KnownCounts = HashMap<MusicSource, BeatPhase>;

impl MusicLibrary {
    /// A library over a cache folder.
    #[must_use]
    pub fn new(cache: FeatureCache, profile: Profile) -> Self {
        Self {
            cache,
            profile,
            extractors: HashMap::new(),
            computed: 0,
            count_periods: Vec::new(),
            counts_late_s: 0.0,
            counts: CountSource::default(),
            network: BeatTracker::default(),
            known: Arc::default(),
        }
    }

    /// Adds the columns of these periods to the conditioning rows, by counts of this tracker.
    #[must_use]
    pub fn with_count_periods(mut self, periods: &[u32], source: CountSource) -> Self {
        self.count_periods = periods.to_vec();
        self.counts = source;
        self
    }

    /// Moves the counts of the columns to so much later, for a model that was trained so.
    #[must_use]
    pub fn with_counts_later(mut self, seconds: f64) -> Self {
        self.counts_late_s = seconds;
        self
    }

    /// Takes the counts of these songs as they are, without a tracker.
    #[must_use]
    pub fn with_known_counts(mut self, known: Arc<KnownCounts>) -> Self {
        self.known = known;
        self
    }

    /// Returns the number of songs whose features were computed so far.
    #[must_use]
    pub fn computed(&self) -> usize {
        self.computed
    }

    /// `[T, 438]` at 7.5 rows a second of the song without its first `phase` frames (of 1/60 s):
    /// row 0 lies at frame `phase` of the dance.
    ///
    /// # Errors
    /// [`DataError`]: the file, the audio, the features or the cache; [`DataError::StoredRows`]
    /// where rows are stored at 60 a second, or would have to be moved.
    pub fn conditioning(
        &mut self,
        music: &MusicSource,
        phase: usize,
    ) -> Result<Array2<f32>, DataError> {
        match music {
            MusicSource::Audio(path) => {
                let rows = self.counted_rows((music, path), phase..phase + 1)?.pop();
                Ok(rows.unwrap_or_else(|| Array2::zeros((0, COLUMNS))))
            }
            MusicSource::DanceRows(path) | MusicSource::Rows(path)
                if !self.count_periods.is_empty() =>
            {
                Err(stored(path, "data.count_periods need the song itself"))
            }
            MusicSource::DanceRows(path) | MusicSource::Rows(path) if phase > 0 => {
                Err(stored(path, "rows of 7.5 a second cannot be moved by single frames"))
            }
            MusicSource::DanceRows(path) | MusicSource::Rows(path) => match json::rows(path)? {
                (rows, Rate::Conditioning) => Ok(rows),
                _ => Err(stored(path, "music_array has 60 rows a second, the GPT needs 7.5")),
            },
        }
    }

    /// Seconds of a song's beats, as the beat network finds them; those of column 53 where there is
    /// no song but its rows, which may have every other beat alone (ARCHITECTURE section 7).
    ///
    /// # Errors
    /// As [`MusicLibrary::conditioning`]; [`DataError::Beats`] where the network fails.
    pub fn beats_s(&mut self, music: &MusicSource) -> Result<Vec<f64>, DataError> {
        match music {
            MusicSource::Audio(path) => Ok(self.network.beats(path)?.beats_s),
            MusicSource::DanceRows(path) | MusicSource::Rows(path) => match json::rows(path)? {
                (rows, Rate::Beats) => {
                    let beats = rows.column(BEAT_COLUMN).into_iter().enumerate();
                    let beats = beats.filter(|(_, beat)| **beat > 0.5);
                    Ok(beats.map(|(frame, _)| frame as f64 / FPS as f64).collect())
                }
                _ => Err(stored(path, "music_array has 7.5 rows a second, beats need 60")),
            },
        }
    }

    /// Returns [`MusicLibrary::conditioning`] of the first `count` start phases; decodes the song
    /// once at most.
    ///
    /// # Errors
    /// As [`MusicLibrary::conditioning`].
    pub fn phases(
        &mut self,
        music: &MusicSource,
        count: usize,
    ) -> Result<Vec<Array2<f32>>, DataError> {
        match music {
            MusicSource::Audio(path) => self.counted_rows((music, path), 0..count),
            _ => (0..count).map(|phase| self.conditioning(music, phase)).collect(),
        }
    }

    /// Conditioning rows of these start phases, with the columns of the count periods after them.
    fn counted_rows(
        &mut self,
        (music, path): (&MusicSource, &Path),
        phases: Range<usize>,
    ) -> Result<Vec<Array2<f32>>, DataError> {
        let all = self.computed_rows(path, Rate::Conditioning, phases.clone())?;
        if self.count_periods.is_empty() {
            return Ok(all);
        }
        let counts = match self.known.get(music) {
            Some(known) => Some(known.clone()),
            None => self.tracked_counts(path)?,
        };
        let all = all.into_iter().zip(phases).map(|(rows, phase)| {
            let start_s = phase as f64 / FPS as f64 - self.counts_late_s;
            with_counts(rows, counts.as_ref(), start_s, &self.count_periods)
        });
        Ok(all.collect())
    }

    /// Counts over the whole song, as in serving.
    fn tracked_counts(&mut self, path: &Path) -> Result<Option<BeatPhase>, DataError> {
        let whole = self.whole(path, Rate::Conditioning)?;
        if self.counts == CountSource::Beatnet {
            let song = self.network.beats(path)?;
            return Ok(BeatPhase::of(&song, whole.view()));
        }
        let beats = self.whole(path, Rate::Beats)?;
        let beats = beats.column(BEAT_COLUMN).into_iter().enumerate();
        let beats = Beats {
            frames: beats.filter(|(_, beat)| **beat > 0.5).map(|(row, _)| row).collect(),
            ..Beats::default()
        };
        Ok(BeatPhase::find(&beats, whole.view()))
    }

    /// Rows of the song from its start on.
    fn whole(&mut self, path: &Path, rate: Rate) -> Result<Array2<f32>, DataError> {
        let rows = self.computed_rows(path, rate, 0..1)?.pop();
        Ok(rows.unwrap_or_else(|| Array2::zeros((0, COLUMNS))))
    }

    fn computed_rows(
        &mut self,
        path: &Path,
        rate: Rate,
        phases: Range<usize>,
    ) -> Result<Vec<Array2<f32>>, DataError> {
        let bytes = files::read(path)?;
        let key = |phase| FeatureKey::new(&bytes, self.profile, rate, phase);
        let keys: Vec<(usize, FeatureKey)> = phases.map(|phase| (phase, key(phase))).collect();
        let known = keys.iter().map(|(_, key)| self.cache.get(key));
        let known: Vec<Option<Array2<f32>>> = known.collect();
        if known.iter().all(Option::is_some) {
            return Ok(known.into_iter().flatten().collect());
        }
        let decoded = decoded(path, bytes, &[rate.hz()])?;
        let signal = decoded.signals.first().map_or(&[][..], Vec::as_slice);
        let mut all = Vec::with_capacity(keys.len());
        for ((phase, key), known) in keys.into_iter().zip(known) {
            let rows = match known {
                Some(rows) => rows,
                None => self.compute(path, signal, rate, (phase, &key))?,
            };
            all.push(rows);
        }
        Ok(all)
    }

    fn compute(
        &mut self,
        path: &Path,
        signal: &[f32],
        rate: Rate,
        (phase, key): (usize, &FeatureKey),
    ) -> Result<Array2<f32>, DataError> {
        let signal = signal.get(samples(phase, rate)..).unwrap_or(&[]);
        let profile = self.profile;
        let extractor = self.extractors.entry(rate.hz());
        let extractor = extractor.or_insert_with(|| FeatureExtractor::new(rate, profile));
        let rows = extractor
            .extract(signal)
            .map_err(|source| DataError::Features { path: path.to_owned(), source })?;
        self.cache.put(key, &rows)?;
        self.computed += 1;
        Ok(rows)
    }
}

/// Samples of `frames` motion frames: exact at both rates, 64 and 512 each.
fn samples(frames: usize, rate: Rate) -> usize {
    let per_frame = (rate.rows_per_second() * HOP as f64 / FPS as f64).round();
    frames * per_frame as usize
}

fn stored(path: &Path, what: &'static str) -> DataError {
    DataError::StoredRows { path: PathBuf::from(path), what }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_a_whole_number_of_samples_at_both_rates() {
        assert_eq!(samples(1, Rate::Conditioning), 64);
        assert_eq!(samples(7, Rate::Beats), 7 * HOP);
        assert_eq!(samples(8, Rate::Conditioning), HOP);
    }
}
