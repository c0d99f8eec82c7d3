//! One model for all layouts: a piece is a motion and, usually, a song.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use bailando::motion::Skeleton;
use clap::{Args, ValueEnum};

use super::Marks;

/// Use of a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum)]
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

/// Source of a piece's motion.
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
    /// Returns the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::Npy(path) | Self::Json(path) | Self::Pickle(path) => path,
        }
    }
}

/// Source of a piece's music.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MusicSource {
    /// An audio file; its time 0 is frame 0 of the motion.
    Audio(PathBuf),
    /// `music_array` in the JSON file of the motion.
    DanceRows(PathBuf),
    /// A JSON file with a `music_array` of 7.5 rows a second.
    Rows(PathBuf),
}

impl MusicSource {
    /// Returns the file.
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
    /// Use of the piece.
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
    /// What the data say about the motion.
    pub marks: Marks,
    /// Place of its folder among those that are read together.
    pub folder: usize,
    /// Weight of that folder.
    pub weight: f64,
}

/// An entry that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Defect {
    /// Which piece.
    pub piece: String,
    /// The mistake.
    pub what: String,
}

/// Dances that lists of a split name and a folder lacks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Absent {
    pub(super) split: Split,
    /// How many the lists name.
    pub(super) named: usize,
    pub(super) ids: Vec<String>,
}

/// Facts that a folder does not hold.
#[derive(Args, Clone, Debug, Default)]
pub struct OpenOptions {
    /// Folder of the songs, where they are kept apart from the motions
    #[arg(long, value_name = "DIR")]
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
    pub(super) absent: Vec<Absent>,
    /// Remarks of the reader, for `check-data`.
    pub(super) notes: Vec<String>,
}
