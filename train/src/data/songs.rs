//! Finding a dance's song in a folder of audio files or of feature files.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use super::{DataError, files};

/// What `bailando::audio` decodes.
const AUDIO: [&str; 13] =
    ["wav", "mp3", "ogg", "oga", "opus", "flac", "m4a", "mp4", "aac", "webm", "aif", "aiff", "mov"];
/// Folders beside motions that usually hold the songs.
const USUAL: [&str; 8] = ["audio", "music", "musics", "all_musics", "wav", "wavs", "mp3", "songs"];

/// Files by name without ending.
#[derive(Debug, Default)]
pub(super) struct Songs {
    by_stem: HashMap<String, PathBuf>,
}

impl Songs {
    /// The audio in `folder`, else in the usual folders inside or beside `root`.
    pub(super) fn audio(root: &Path, folder: Option<&Path>) -> Result<Self, DataError> {
        let mut songs = Self::default();
        match folder {
            Some(folder) => songs.add_audio(folder)?,
            None => {
                songs.add_audio(root)?;
                for name in USUAL {
                    let folder = root.join(name);
                    if folder.is_dir() {
                        songs.add_audio(&folder)?;
                    }
                }
            }
        }
        Ok(songs)
    }

    /// Takes in the audio of `folder`.
    pub(super) fn add_audio(&mut self, folder: &Path) -> Result<(), DataError> {
        self.add(folder, &AUDIO)
    }

    /// Takes in the files of `folder` that end so; names that are known already stay.
    pub(super) fn add(&mut self, folder: &Path, extensions: &[&str]) -> Result<(), DataError> {
        for path in files::list(folder)? {
            if files::has_extension(&path, extensions) {
                self.by_stem.entry(files::stem(&path)).or_insert(path);
            }
        }
        Ok(())
    }

    /// Returns the song of the motion `id`: of the same name, else of the name of its music. AIST++
    /// ids are `genre_situation_camera_dancer_music_choreography`.
    pub(super) fn of(&self, id: &str) -> Option<&PathBuf> {
        let music = || id.rsplit('_').nth(1).and_then(|music| self.by_stem.get(music));
        self.by_stem.get(id).or_else(music)
    }
}
