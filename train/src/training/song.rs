//! The songs that a policy generates motion for: no recording is needed.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use ndarray::Array2;
use rayon::prelude::*;

use super::{
    config::DataConfig,
    error::TrainError,
    songs::{feature_cache, known_counts, music_library},
};
use crate::data::{DataError, FPS, FRAMES_PER_CODE, MusicLibrary, MusicSource, Portion, Training};

/// A song's features, and where its beats are.
#[derive(Clone, Debug, PartialEq)]
pub struct Song {
    /// `[rows, columns]` features, row `k` at frame `8 k`.
    pub rows: Array2<f32>,
    /// Whether there is a beat, by frame at 60 fps.
    pub beats: Vec<bool>,
    /// Name of the style that it is danced in, where the data have one.
    pub style: Option<String>,
}

impl Song {
    /// Reads features and beats of a song. The beats are those of the data, in seconds; without
    /// any, those that are heard in it.
    fn read(
        music: &MusicSource,
        (told, style): (&[f64], Option<&str>),
        library: &mut MusicLibrary,
    ) -> Result<Self, DataError> {
        let rows = library.conditioning(music, 0)?;
        let frames = rows.nrows() * FRAMES_PER_CODE;
        let beats = match told {
            [] => beats_by_frame(&library.beats_s(music)?, frames),
            told => beats_by_frame(told, frames),
        };
        Ok(Self { rows, beats, style: style.map(str::to_owned) })
    }
}

/// Returns whether there is a beat, for each frame.
fn beats_by_frame(beats_s: &[f64], frames: usize) -> Vec<bool> {
    let mut beats = vec![false; frames];
    for beat in beats_s {
        let frame = (beat * FPS as f64).round();
        // A beat before the song's start is none of its frames.
        if let Some(beat) = beats.get_mut(frame as usize).filter(|_| frame >= 0.0) {
            *beat = true;
        }
    }
    beats
}

/// Reads an audio file that a policy adapts to, with its counts so much later than the tracker has
/// them.
///
/// # Errors
/// [`TrainError`] names what is wrong with it.
pub fn target_song(data: &DataConfig, counts_late_s: f64, path: &Path) -> Result<Song, TrainError> {
    let library = music_library(data, feature_cache(data)?, &Arc::default());
    let mut library = library.with_counts_later(counts_late_s);
    Ok(Song::read(&MusicSource::Audio(path.to_owned()), (&[], None), &mut library)?)
}

/// Reads every song of the training split, once.
pub(super) fn training_songs(
    data: &DataConfig,
    portion: &Portion<Training>,
) -> Result<Vec<Song>, TrainError> {
    let cache = feature_cache(data)?;
    let known = known_counts(data, portion);
    let library = || music_library(data, cache.clone(), &known);
    let mut music: BTreeMap<&MusicSource, (&[f64], Option<&str>)> = BTreeMap::new();
    for dance in portion.recordings() {
        let style = dance.marks().style.as_deref();
        let songs = dance.songs().iter();
        music.extend(
            songs.filter_map(|song| Some((song.music.as_ref()?, (&song.grid_beats_s[..], style)))),
        );
    }
    let songs = music
        .into_par_iter()
        .map_init(library, |library, (music, told)| Song::read(music, told, library));
    // The first in order that fails is reported, whichever was read first.
    let songs: Vec<Result<_, DataError>> = songs.collect();
    Ok(songs.into_iter().collect::<Result<_, _>>()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beats_fall_on_the_nearest_frame_of_the_song() {
        let beats = beats_by_frame(&[-0.1, 0.0, 0.051, 0.1, 0.2], 12);
        let frames: Vec<usize> = (0..12).filter(|&frame| beats[frame]).collect();
        assert_eq!(frames, [0, 3, 6]);
    }
}
