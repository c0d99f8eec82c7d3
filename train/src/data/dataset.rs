//! One model for all layouts: a piece is a motion and, usually, a song.

use std::{
    collections::HashMap,
    fmt,
    path::{Path, PathBuf},
};

use bailando::{
    model::file_sha256,
    motion::{Positions, Skeleton},
};

use super::{
    DataError, Evaluation, Motion, Portion, Training, aist, files, folder, json, npy, smpl,
};

/// What a piece may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Split {
    /// For training.
    Train,
    /// For evaluation alone.
    Test,
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Train => "train",
            Self::Test => "test",
        })
    }
}

/// How a folder is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// `index.json`, `.npy` motions and audio files.
    Folder,
    /// The reference's JSON files with `music_array` and `dance_array`.
    Reference,
    /// AIST++ `.pkl` motions beside a folder of audio.
    Aist,
}

impl fmt::Display for Layout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Folder => "a folder with index.json",
            Self::Reference => "JSON files of the reference",
            Self::Aist => "AIST++ .pkl motions",
        })
    }
}

/// Where a piece's motion is.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MotionSource {
    /// Positions as `.npy`.
    Npy(PathBuf),
    /// `dance_array` of a JSON file.
    Json(PathBuf),
    /// SMPL rotations in a pickle.
    Pickle(PathBuf),
}

impl MotionSource {
    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::Npy(path) | Self::Json(path) | Self::Pickle(path) => path,
        }
    }

    /// Reads the motion; rotations are put on `skeleton`.
    ///
    /// # Errors
    /// [`DataError`] names the file and what is wrong with it.
    pub fn load(&self, skeleton: &Skeleton) -> Result<Motion, DataError> {
        self.positions(skeleton).map(Motion::new)
    }

    pub(super) fn positions(&self, skeleton: &Skeleton) -> Result<Positions, DataError> {
        match self {
            Self::Npy(path) => npy::positions(path),
            Self::Json(path) => json::positions(path),
            Self::Pickle(path) => smpl::positions(path, skeleton),
        }
    }
}

/// Where a piece's music is.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MusicSource {
    /// An audio file; its time 0 is frame 0 of the motion.
    Audio(PathBuf),
    /// `music_array` in the JSON file of the dance.
    DanceRows(PathBuf),
    /// A JSON file with a `music_array` of 7.5 rows a second.
    Rows(PathBuf),
}

impl MusicSource {
    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::Audio(path) | Self::DanceRows(path) | Self::Rows(path) => path,
        }
    }

    /// Whether its rows can be computed from any moment on: only audio can be cut anywhere.
    #[must_use]
    pub fn can_shift(&self) -> bool {
        matches!(self, Self::Audio(_))
    }
}

/// One motion with one song (or none).
#[derive(Clone, Debug)]
pub struct Piece {
    /// Name of the piece.
    pub id: String,
    /// Kind of dance, where the data say.
    pub style: Option<String>,
    /// What the piece may be used for.
    pub split: Split,
    /// The motion.
    pub motion: MotionSource,
    /// The song; motion alone still trains the VQ-VAE.
    pub music: Option<MusicSource>,
    /// Frames that the index declares.
    pub frames: Option<usize>,
    /// Seconds that the index declares.
    pub seconds: Option<f64>,
    /// Frames per second that the index declares.
    pub fps: Option<f64>,
    /// Beats of the music in seconds from frame 0, where the data have them.
    pub grid_beats_s: Vec<f64>,
    /// Beats per minute.
    pub bpm: Option<f64>,
    /// Recording that the motion was made from: variants of one recording share it.
    pub source: Option<String>,
}

/// An entry that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Defect {
    /// Which piece.
    pub piece: String,
    /// What is wrong with it.
    pub what: String,
}

/// What a folder does not say itself.
#[derive(Clone, Debug, Default)]
pub struct OpenOptions {
    /// Folder of audio files, for layouts that keep them apart.
    pub audio: Option<PathBuf>,
}

/// A folder of training data: its pieces, read when asked for.
#[derive(Clone, Debug)]
pub struct Dataset {
    pub(super) root: PathBuf,
    pub(super) layout: Layout,
    pub(super) skeleton: Skeleton,
    pub(super) pieces: Vec<Piece>,
    pub(super) defects: Vec<Defect>,
    /// Remarks of the reader, for `check-data`.
    pub(super) notes: Vec<String>,
}

impl Dataset {
    /// Opens a folder whose every entry can be used.
    ///
    /// # Errors
    /// [`DataError`], naming the first unusable entry; `check-data` lists them all.
    pub fn open(root: &Path, options: &OpenOptions) -> Result<Self, DataError> {
        let dataset = Self::survey(root, options)?;
        match dataset.defects.first() {
            None => Ok(dataset),
            Some(Defect { piece, what }) => Err(DataError::Entry {
                path: root.to_owned(),
                piece: piece.clone(),
                what: what.clone(),
            }),
        }
    }

    /// Opens a folder, setting unusable entries aside.
    pub(super) fn survey(root: &Path, options: &OpenOptions) -> Result<Self, DataError> {
        let audio = options.audio.as_deref();
        if root.join(folder::INDEX).is_file() {
            folder::read(root)
        } else if let Some(motions) = aist::motions(root)? {
            aist::read(root, &motions, audio)
        } else if let Some(dances) = json::dances(root)? {
            json::read(root, dances, audio)
        } else {
            Err(DataError::Layout(root.to_owned()))
        }
    }

    /// The folder.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// How the folder is laid out.
    #[must_use]
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// The skeleton that the motions are on.
    #[must_use]
    pub fn skeleton(&self) -> &Skeleton {
        &self.skeleton
    }

    /// Everything that a model may learn from, and nothing else.
    ///
    /// # Errors
    /// [`DataError::Empty`]; [`DataError::Leak`] when a test motion (by its bytes) is among the
    /// training pieces; [`DataError::Read`].
    pub fn training(&self) -> Result<Portion<Training>, DataError> {
        self.refuse_leaks()?;
        Portion::of(self)
    }

    /// Everything that a model is judged by.
    ///
    /// # Errors
    /// [`DataError::Empty`].
    pub fn evaluation(&self) -> Result<Portion<Evaluation>, DataError> {
        Portion::of(self)
    }

    fn refuse_leaks(&self) -> Result<(), DataError> {
        let mut seen: HashMap<String, (Split, String)> = HashMap::new();
        let mut files: Vec<&Piece> = self.pieces.iter().collect();
        files.sort_by_key(|piece| (&piece.motion, piece.split));
        files.dedup_by_key(|piece| (&piece.motion, piece.split));
        for piece in files {
            let path = piece.motion.path();
            let mut file = std::fs::File::open(path).map_err(files::failed(path))?;
            let hash = file_sha256(&mut file).map_err(files::failed(path))?;
            let name = path.file_name().unwrap_or_default();
            let name = name.to_string_lossy().into_owned();
            match seen.get(&hash) {
                Some((split, other)) if *split != piece.split => {
                    let (train, test) = match piece.split {
                        Split::Train => (name, other.clone()),
                        Split::Test => (other.clone(), name),
                    };
                    return Err(DataError::Leak { train, test });
                }
                _ => drop(seen.insert(hash, (piece.split, name))),
            }
        }
        Ok(())
    }
}
