//! Where the beats of the music come from.

use std::{
    collections::{BTreeMap, HashMap},
    fmt, fs,
    path::{Path, PathBuf},
};

use serde::Deserialize;

use super::{
    EvaluationError,
    body::FRAMES_PER_SECOND,
    load::{entries, stem, text},
    reference::Reference,
};
use bailando_audio::{self as audio, AudioLimits, AudioRange};
use bailando_core::CancelToken;
use bailando_features::{FeatureExtractor, Profile, Rate};

/// Where beats come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BeatSource {
    /// A file of beats.
    File,
    /// Column 53 of the features of the audio, as published.
    Audio,
    /// The counts that the data folder knows: not what published scores use.
    Grid,
}

impl fmt::Display for BeatSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::File => "beats file",
            Self::Audio => "column 53 of the audio's features",
            Self::Grid => "grid_beats_s of the data folder",
        })
    }
}

/// Music beats of every piece, in frames at 60 a second, ascending.
#[derive(Clone, Debug)]
pub struct MusicBeats {
    /// Where they come from.
    pub source: BeatSource,
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
    /// Beats of `pieces` from a JSON file: frames by piece id, audio file name or its stem.
    ///
    /// # Errors
    /// [`EvaluationError`] if the file is none or a piece is not in it.
    pub fn from_file<'a>(
        path: &Path,
        pieces: impl IntoIterator<Item = &'a str>,
        reference: &Reference,
    ) -> Result<Self, EvaluationError> {
        let table = match serde_json::from_str(&text(path)?) {
            Ok(BeatsFile::Named { beats } | BeatsFile::Bare(beats)) => beats,
            Err(_) => {
                return Err(EvaluationError::File {
                    path: path.to_owned(),
                    problem: "it is no table of beats: {\"beats\": {name: [frame, ..]}}".into(),
                });
            }
        };
        Self::collect(BeatSource::File, pieces, |id| {
            let names = names(id, reference);
            names
                .iter()
                .find_map(|name| table.get(name))
                .cloned()
                .ok_or_else(|| {
                    missing(
                        id,
                        format!("{} has none of {}", path.display(), names.join(", ")),
                    )
                })
        })
    }

    /// Beats of `pieces` heard in the audio files of a folder, found by stem: the piece's id, or
    /// the name that the data folder gives.
    ///
    /// # Errors
    /// [`EvaluationError`] if a piece has no audio file, or it can't be decoded.
    pub fn from_audio<'a>(
        folder: &Path,
        pieces: impl IntoIterator<Item = &'a str>,
        reference: &Reference,
    ) -> Result<Self, EvaluationError> {
        let mut ear = Ear::new(folder)?;
        Self::collect(BeatSource::Audio, pieces, |id| {
            let names = names(id, reference);
            match names.iter().find_map(|name| ear.files.get(name)).cloned() {
                Some(path) => ear.beats(&path),
                None => {
                    let places = names.join(", ");
                    Err(missing(
                        id,
                        format!("{} has no audio named {places}", folder.display()),
                    ))
                }
            }
        })
    }

    /// The counts of the data folder; none where a piece has no counts.
    #[must_use]
    pub fn from_grid<'a>(
        pieces: impl IntoIterator<Item = &'a str>,
        reference: &Reference,
    ) -> Option<Self> {
        let grid = |id: &str| -> Option<Vec<usize>> {
            let seconds = &reference.info(id)?.grid_beats_s;
            let frames = seconds
                .iter()
                .map(|s| (s * FRAMES_PER_SECOND).round_ties_even());
            let frames = frames
                .filter(|frame| *frame >= 0.0)
                .map(|frame| frame as usize);
            (!seconds.is_empty()).then(|| frames.collect())
        };
        Self::collect(BeatSource::Grid, pieces, |id| {
            grid(id).ok_or_else(|| missing(id, String::new()))
        })
        .ok()
    }

    fn collect<'a>(
        source: BeatSource,
        pieces: impl IntoIterator<Item = &'a str>,
        mut find: impl FnMut(&str) -> Result<Vec<usize>, EvaluationError>,
    ) -> Result<Self, EvaluationError> {
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

    /// Beats of a piece; empty for one that was not asked about.
    #[must_use]
    pub fn of(&self, id: &str) -> &[usize] {
        self.by_piece.get(id).map_or(&[], Vec::as_slice)
    }
}

/// What a piece's music may be called: its id, its audio file and that file's stem.
fn names(id: &str, reference: &Reference) -> Vec<String> {
    let mut names = vec![id.to_owned()];
    if let Some(audio) = reference.info(id).and_then(|piece| piece.audio.as_deref()) {
        names.push(audio.to_string_lossy().into_owned());
        names.push(stem(audio));
    }
    names
}

fn missing(piece: &str, problem: String) -> EvaluationError {
    EvaluationError::Beats {
        piece: piece.to_owned(),
        problem,
    }
}

/// Hears the beats of audio files, each file once.
struct Ear {
    files: HashMap<String, PathBuf>,
    extractor: FeatureExtractor,
    heard: HashMap<PathBuf, Vec<usize>>,
}

impl Ear {
    fn new(folder: &Path) -> Result<Self, EvaluationError> {
        const EXTENSIONS: [&str; 8] = ["wav", "flac", "mp3", "ogg", "oga", "m4a", "mp4", "aac"];
        let is_audio = |path: &PathBuf| {
            let extension = path.extension().and_then(|extension| extension.to_str());
            extension.is_some_and(|e| EXTENSIONS.contains(&e.to_ascii_lowercase().as_str()))
        };
        let files = entries(folder)?.into_iter().filter(is_audio);
        Ok(Self {
            files: files.map(|path| (stem(&path), path)).collect(),
            extractor: FeatureExtractor::new(Rate::Beats, Profile::Librosa011),
            heard: HashMap::new(),
        })
    }

    fn beats(&mut self, path: &Path) -> Result<Vec<usize>, EvaluationError> {
        if let Some(beats) = self.heard.get(path) {
            return Ok(beats.clone());
        }
        let fail = |problem: String| EvaluationError::File {
            path: path.to_owned(),
            problem,
        };
        let bytes = fs::read(path).map_err(|source| EvaluationError::Io {
            path: path.to_owned(),
            source,
        })?;
        let decoded = audio::decode(
            bytes.into(),
            AudioRange::default(),
            &[Rate::Beats.hz()],
            &AudioLimits::default(),
            &CancelToken::new(),
        )
        .map_err(|error| fail(error.to_string()))?;
        let signal = decoded.signals.first().map_or(&[][..], Vec::as_slice);
        let beats = self
            .extractor
            .beats(signal)
            .map_err(|error| fail(error.to_string()))?;
        self.heard.insert(path.to_owned(), beats.frames.clone());
        Ok(beats.frames)
    }
}
