//! The pieces of one split, as a type: a `Portion<Training>` cannot hand out test pieces, and a
//! function of it cannot be given a `Portion<Evaluation>`.

use std::{collections::BTreeMap, marker::PhantomData};

use bailando::{features::BeatPhase, motion::Skeleton};

use super::{DataError, Dataset, Marks, Motion, MotionSource, MusicSource, Split};

mod sealed {
    pub trait Sealed {}
}

/// One of [`Training`] and [`Evaluation`].
pub trait SplitKind: sealed::Sealed {
    /// The split it stands for.
    const SPLIT: Split;
}

/// Marks data for training.
#[derive(Clone, Copy, Debug)]
pub enum Training {}
/// Marks data for evaluation.
#[derive(Clone, Copy, Debug)]
pub enum Evaluation {}

impl sealed::Sealed for Training {}
impl sealed::Sealed for Evaluation {}

impl SplitKind for Training {
    const SPLIT: Split = Split::Train;
}

impl SplitKind for Evaluation {
    const SPLIT: Split = Split::Test;
}

/// Everything of one split: recordings, each once, with all of its songs.
#[derive(Clone, Debug)]
pub struct Portion<S> {
    recordings: Vec<Recording<S>>,
    skeleton: Skeleton,
}

/// One motion file. Weights go by motion, not by piece: seven songs for one motion must not make it
/// seven times as important.
#[derive(Clone, Debug)]
pub struct Recording<S> {
    source: MotionSource,
    songs: Vec<Song>,
    marks: Marks,
    weight: f64,
    split: PhantomData<S>,
}

/// A song that goes with a motion: one piece of the data.
#[derive(Clone, Debug)]
pub struct Song {
    /// The piece's id.
    pub id: String,
    /// Where the music is; none for motion without music.
    pub music: Option<MusicSource>,
    /// Beats in seconds from frame 0, where the data have them.
    pub grid_beats_s: Vec<f64>,
    /// Beats per minute, where the data state them.
    pub bpm: Option<f64>,
}

impl<S: SplitKind> Portion<S> {
    pub(super) fn of(dataset: &Dataset) -> Result<Self, DataError> {
        let mut recordings: BTreeMap<(usize, &MotionSource), Recording<S>> = BTreeMap::new();
        for piece in dataset.pieces.iter().filter(|piece| piece.split == S::SPLIT) {
            let dance =
                recordings.entry((piece.folder, &piece.motion)).or_insert_with(|| Recording {
                    source: piece.motion.clone(),
                    songs: Vec::new(),
                    marks: piece.marks.clone(),
                    weight: piece.weight,
                    split: PhantomData,
                });
            dance.songs.push(Song {
                id: piece.id.clone(),
                music: piece.music.clone(),
                grid_beats_s: piece.grid_beats_s.clone(),
                bpm: piece.bpm,
            });
        }
        if recordings.is_empty() {
            return Err(DataError::Empty { path: dataset.root.clone(), split: S::SPLIT });
        }
        Ok(Self {
            recordings: recordings.into_values().collect(),
            skeleton: dataset.skeleton.clone(),
        })
    }

    /// Returns the recordings, in a fixed order.
    #[must_use]
    pub fn recordings(&self) -> &[Recording<S>] {
        &self.recordings
    }

    /// Returns the skeleton of all motions.
    #[must_use]
    pub fn skeleton(&self) -> &Skeleton {
        &self.skeleton
    }
}

impl<S> Recording<S> {
    /// Returns the source of the motion.
    #[must_use]
    pub fn source(&self) -> &MotionSource {
        &self.source
    }

    /// Returns the songs that go with it, one per piece.
    #[must_use]
    pub fn songs(&self) -> &[Song] {
        &self.songs
    }

    /// Returns what the data say about it.
    #[must_use]
    pub fn marks(&self) -> &Marks {
        &self.marks
    }

    /// Returns the weight of its data folder.
    #[must_use]
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Returns the beats that all of its songs share, in seconds from frame 0; none where the data
    /// have none.
    #[must_use]
    pub fn grid_beats_s(&self) -> &[f64] {
        let grids = self.songs.iter().map(|song| song.grid_beats_s.as_slice());
        grids.max_by_key(|grid| grid.len()).unwrap_or_default()
    }

    /// Returns the songs whose beats the data say, with the counts that these make.
    pub fn known_counts(&self) -> impl Iterator<Item = (&MusicSource, BeatPhase)> {
        let songs = self.songs.iter();
        songs.filter_map(|song| Some((song.music.as_ref()?, self.counts(&song.grid_beats_s)?)))
    }

    /// Returns the counts of all songs in seconds from frame 0; none where the data have no beats.
    #[must_use]
    pub fn counts_s(&self) -> Vec<f64> {
        let counts = self.counts(self.grid_beats_s());
        counts.map(|counts| counts.counts_s().to_vec()).unwrap_or_default()
    }

    fn counts(&self, beats_s: &[f64]) -> Option<BeatPhase> {
        BeatPhase::of_beats(beats_s, self.marks.first_count.saturating_sub(1))
    }

    /// Reads the motion.
    ///
    /// # Errors
    /// [`DataError`] names the file and what is wrong with it.
    pub fn motion(&self, skeleton: &Skeleton) -> Result<Motion, DataError> {
        self.source.load(skeleton)
    }
}
