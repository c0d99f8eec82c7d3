//! The music that a policy dances to: no dance is needed.

use std::collections::BTreeSet;

use bailando::features::BEAT_COLUMN;
use ndarray::Array2;

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
    ///
    /// # Errors
    /// [`DataError`] names the file and what is wrong with it.
    pub fn read(music: &MusicSource, library: &mut MusicLibrary) -> Result<Self, DataError> {
        let rows = library.conditioning(music, 0)?;
        let beats = library.beats(music, 0)?;
        let beats = beats
            .column(BEAT_COLUMN)
            .into_iter()
            .map(|&beat| beat > 0.5);
        Ok(Self {
            rows,
            beats: beats.collect(),
        })
    }

    /// Every song of the training split, once.
    ///
    /// # Errors
    /// As [`Song::read`].
    pub fn of_training(
        portion: &Portion<Training>,
        library: &mut MusicLibrary,
    ) -> Result<Vec<Self>, DataError> {
        let songs = portion.dances().iter().flat_map(|dance| dance.songs());
        let music: BTreeSet<&MusicSource> = songs.filter_map(|song| song.music.as_ref()).collect();
        let songs = music.into_iter().map(|music| Self::read(music, library));
        songs.collect()
    }
}
