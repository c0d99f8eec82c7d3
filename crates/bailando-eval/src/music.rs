//! Beats of the music, by piece.

use std::{
    collections::{BTreeMap, HashMap},
    fs,
    path::{Path, PathBuf},
    rc::Rc,
};

use serde::Deserialize;

use crate::{
    body::FRAMES_PER_SECOND,
    error::EvaluationError,
    files::{entries, stem, text},
    form::SongForm,
    sets::Reference,
};
use bailando_audio::{self as audio, AudioLimits, AudioRange};
use bailando_core::CancelToken;
use bailando_features::{FeatureExtractor, Profile, Rate};

/// Source of the music beats.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum BeatsFrom {
    /// The counts of the reference, where it is a data folder that has them: not the beats of
    /// published scores.
    #[default]
    Reference,
    /// A JSON file of frames by name.
    File(PathBuf),
    /// A folder of audio files: column 53 of their features, as published.
    Audio(PathBuf),
    /// A folder of songs that are no pieces of the reference; its own row has no beats then.
    NewSongs {
        /// The songs.
        folder: PathBuf,
        /// Their beats as in [`BeatsFrom::File`]; absent: as in [`BeatsFrom::Audio`].
        beats: Option<PathBuf>,
    },
}

/// Music beats of every piece, in frames at 60 a second, ascending.
#[derive(Clone, Debug)]
pub(crate) struct MusicBeats {
    /// Their source, in words.
    pub(crate) source: &'static str,
    by_piece: BTreeMap<String, Vec<usize>>,
}

/// A beats file: `beats` by name, or the names alone.
#[derive(Deserialize)]
#[serde(untagged)]
enum BeatsFile {
    Named { beats: BTreeMap<String, Vec<usize>> },
    Bare(BTreeMap<String, Vec<usize>>),
}

impl MusicBeats {
    /// Finds the beats of `pieces`; none where the reference has no counts of a piece.
    ///
    /// # Errors
    /// [`EvaluationError`] if a file can't be read or decoded, or has no beats of a piece.
    pub(crate) fn find<'a>(
        from: &BeatsFrom,
        pieces: impl IntoIterator<Item = &'a str>,
        reference: &Reference,
    ) -> Result<Option<Self>, EvaluationError> {
        match from {
            BeatsFrom::Reference => {
                let source = "grid_beats_s of the data folder";
                Ok(Self::collect(source, pieces, |id| grid(id, reference).ok_or(())).ok())
            }
            BeatsFrom::File(path) | BeatsFrom::NewSongs { beats: Some(path), .. } => {
                let table = beats_file(path)?;
                let beats = Self::collect("beats file", pieces, |id| {
                    let names = names(id, reference);
                    let beats = names.iter().find_map(|name| table.get(name)).cloned();
                    beats.ok_or_else(|| missing(id, path, "none of", &names))
                });
                beats.map(Some)
            }
            BeatsFrom::Audio(folder) | BeatsFrom::NewSongs { folder, beats: None } => {
                let mut songs = SongBeats::new(folder)?;
                let beats = Self::collect("column 53 of the audio's features", pieces, |id| {
                    let names = names(id, reference);
                    match names.iter().find_map(|name| songs.files.get(name)).cloned() {
                        Some(path) => songs.beats(&path),
                        None => Err(missing(id, folder, "no audio named", &names)),
                    }
                });
                beats.map(Some)
            }
        }
    }

    fn collect<'a, E>(
        source: &'static str,
        pieces: impl IntoIterator<Item = &'a str>,
        mut find: impl FnMut(&str) -> Result<Vec<usize>, E>,
    ) -> Result<Self, E> {
        let mut by_piece = BTreeMap::new();
        for id in pieces {
            if !by_piece.contains_key(id) {
                let mut beats = find(id)?;
                beats.sort_unstable();
                by_piece.insert(id.to_owned(), beats);
            }
        }
        Ok(Self { source, by_piece })
    }

    /// Returns the beats of a piece; none of a piece that was not looked for.
    pub(crate) fn of(&self, id: &str) -> &[usize] {
        self.by_piece.get(id).map_or(&[], Vec::as_slice)
    }
}

/// The form of every piece's song.
#[derive(Debug)]
pub(crate) struct SongForms(BTreeMap<String, Rc<SongForm>>);

impl SongForms {
    /// Finds the form of the songs of `pieces`, whose beats are known: files of the folder that
    /// beats are from, or those of the data folder.
    ///
    /// # Errors
    /// [`EvaluationError`] if a song can't be found or decoded.
    pub(crate) fn find<'a>(
        from: &BeatsFrom,
        beats: &MusicBeats,
        pieces: impl IntoIterator<Item = &'a str>,
        reference: &Reference,
    ) -> Result<Self, EvaluationError> {
        let folder = match from {
            BeatsFrom::Audio(folder) | BeatsFrom::NewSongs { folder, .. } => Some(folder),
            BeatsFrom::Reference | BeatsFrom::File(_) => None,
        };
        let files = folder.map(|folder| songs(folder)).transpose()?.unwrap_or_default();
        let mut extractor = FeatureExtractor::new(Rate::Conditioning, Profile::Librosa011);
        let mut known: HashMap<PathBuf, Option<Rc<SongForm>>> = HashMap::new();
        let mut by_piece = BTreeMap::new();
        for id in pieces {
            let own = names(id, reference).iter().find_map(|name| files.get(name)).cloned();
            let audio = reference.info(id).and_then(|piece| piece.audio.as_deref());
            let path = own.or_else(|| Some(reference.folder.join(audio?)));
            let path = path.ok_or_else(|| {
                let problem = format!("piece {id} has no song whose form could be found");
                EvaluationError::Option(problem)
            })?;
            let form = match known.get(&path) {
                Some(form) => form.clone(),
                None => {
                    let rows = extractor.extract(&decode(&path, Rate::Conditioning)?);
                    let rows =
                        rows.map_err(|error| EvaluationError::file(&path, error.to_string()));
                    let form = SongForm::new(rows?.view(), beats.of(id)).map(Rc::new);
                    known.insert(path, form.clone());
                    form
                }
            };
            by_piece.extend(form.map(|form| (id.to_owned(), form)));
        }
        Ok(Self(by_piece))
    }

    /// Returns the form of a piece's song; none where it has no regular beats.
    pub(crate) fn of(&self, id: &str) -> Option<&SongForm> {
        self.0.get(id).map(Rc::as_ref)
    }
}

/// The songs of a folder, by name.
fn songs(folder: &Path) -> Result<HashMap<String, PathBuf>, EvaluationError> {
    let files = entries(folder)?.into_iter().filter(|path| is_song(path));
    Ok(files.map(|path| (stem(&path), path)).collect())
}

/// Decodes a song.
fn decode(path: &Path, rate: Rate) -> Result<Vec<f32>, EvaluationError> {
    let bytes = fs::read(path).map_err(EvaluationError::io(path))?;
    let (range, limits) = (AudioRange::default(), AudioLimits::default());
    let decoded = audio::decode(bytes.into(), range, &[rate.hz()], &limits, &CancelToken::new())
        .map_err(|error| EvaluationError::file(path, error.to_string()))?;
    Ok(decoded.signals.into_iter().next().unwrap_or_default())
}

/// Returns the counts of a piece in the data folder.
fn grid(id: &str, reference: &Reference) -> Option<Vec<usize>> {
    let seconds = &reference.info(id)?.grid_beats_s;
    let frames = seconds.iter().map(|s| (s * FRAMES_PER_SECOND).round_ties_even());
    let frames = frames.filter(|frame| *frame >= 0.0);
    (!seconds.is_empty()).then(|| frames.map(|frame| frame as usize).collect())
}

fn beats_file(path: &Path) -> Result<BTreeMap<String, Vec<usize>>, EvaluationError> {
    match serde_json::from_str(&text(path)?) {
        Ok(BeatsFile::Named { beats } | BeatsFile::Bare(beats)) => Ok(beats),
        Err(_) => {
            let problem = "it is no table of beats: {\"beats\": {name: [frame, ..]}}";
            Err(EvaluationError::file(path, problem))
        }
    }
}

/// The names that a piece's music may have: its id, its audio file and that file's stem.
fn names(id: &str, reference: &Reference) -> Vec<String> {
    let mut names = vec![id.to_owned()];
    if let Some(audio) = reference.info(id).and_then(|piece| piece.audio.as_deref()) {
        names.push(audio.to_string_lossy().into_owned());
        names.push(stem(audio));
    }
    names
}

fn missing(piece: &str, place: &Path, lacks: &str, names: &[String]) -> EvaluationError {
    EvaluationError::Beats {
        piece: piece.to_owned(),
        problem: format!("{} has {lacks} {}", place.display(), names.join(", ")),
    }
}

/// Whether a file of a folder of songs is one, by its extension.
pub(crate) fn is_song(path: &Path) -> bool {
    const EXTENSIONS: [&str; 8] = ["wav", "flac", "mp3", "ogg", "oga", "m4a", "mp4", "aac"];
    let extension = path.extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|e| EXTENSIONS.contains(&e.to_ascii_lowercase().as_str()))
}

/// Beats of the audio files in a folder, each file decoded once.
struct SongBeats {
    files: HashMap<String, PathBuf>,
    extractor: FeatureExtractor,
    known: HashMap<PathBuf, Vec<usize>>,
}

impl SongBeats {
    fn new(folder: &Path) -> Result<Self, EvaluationError> {
        Ok(Self {
            files: songs(folder)?,
            extractor: FeatureExtractor::new(Rate::Beats, Profile::Librosa011),
            known: HashMap::new(),
        })
    }

    fn beats(&mut self, path: &Path) -> Result<Vec<usize>, EvaluationError> {
        if let Some(beats) = self.known.get(path) {
            return Ok(beats.clone());
        }
        let beats = self.extractor.beats(&decode(path, Rate::Beats)?);
        let beats = beats.map_err(|error| EvaluationError::file(path, error.to_string()))?;
        self.known.insert(path.to_owned(), beats.frames.clone());
        Ok(beats.frames)
    }
}
