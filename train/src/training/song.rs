//! The music that a policy dances to: no dance is needed.

use std::{collections::BTreeSet, path::Path};

use bailando::features::BEAT_COLUMN;
use ndarray::Array2;
use rayon::prelude::*;

use super::{
    TrainError,
    config::DataConfig,
    songs::{feature_cache, music_library},
};
use crate::data::{DataError, MusicLibrary, MusicSource, Portion, Training};

/// A song's features, and where its beats are.
#[derive(Clone, Debug, PartialEq)]
pub struct Song {
    /// `[rows, columns]` features, row `k` at frame `8 k`.
    pub rows: Array2<f32>,
    /// Whether there is a beat, by frame at 60 fps.
    pub beats: Vec<bool>,
}

impl Song {
    /// Features and beats of a song; beats are column 53 of its features at 60 rows a second
    /// (ARCHITECTURE section 7).
    fn read(music: &MusicSource, library: &mut MusicLibrary) -> Result<Self, DataError> {
        let rows = library.conditioning(music, 0)?;
        let beats = library.beats(music, 0)?;
        let beats = beats.column(BEAT_COLUMN);
        Ok(Self {
            rows,
            beats: beats.into_iter().map(|&beat| beat > 0.5).collect(),
        })
    }
}

/// An audio file that a policy is to adapt to.
///
/// # Errors
/// [`TrainError`] names what is wrong with it.
pub fn target_song(data: &DataConfig, path: &Path) -> Result<Song, TrainError> {
    let mut library = music_library(data, feature_cache(data)?);
    Ok(Song::read(
        &MusicSource::Audio(path.to_owned()),
        &mut library,
    )?)
}

/// Every song of the training split, once.
pub(super) fn training_songs(
    data: &DataConfig,
    portion: &Portion<Training>,
) -> Result<Vec<Song>, TrainError> {
    let cache = feature_cache(data)?;
    let library = || music_library(data, cache.clone());
    let songs = portion.dances().iter().flat_map(|dance| dance.songs());
    let music: BTreeSet<&MusicSource> = songs.filter_map(|song| song.music.as_ref()).collect();
    let songs = music
        .into_par_iter()
        .map_init(library, |library, music| Song::read(music, library));
    // The first that fails is told of, whichever was read first.
    let songs: Vec<Result<_, DataError>> = songs.collect();
    Ok(songs.into_iter().collect::<Result<_, _>>()?)
}
