//! What can be wrong with training data.

use std::path::PathBuf;

use bailando::{audio::AudioError, features::FeatureError, motion::MotionError};

use super::Split;
use crate::checkpoint::Problem;

/// What can be wrong with training data: always one line that names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages are the documentation")]
pub enum DataError {
    #[error("{}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: {bytes} bytes are more than the {limit} that such a file may \
             have", path.display())]
    TooLarge { path: PathBuf, bytes: u64, limit: u64 },
    #[error("{}: {source}", path.display())]
    Json { path: PathBuf, source: serde_json::Error },
    #[error(
        "{}: no training data here: expected index.json, or JSON files with dance_array, or .pkl \
         motions (also in motions/)",
        .0.display()
    )]
    Layout(PathBuf),
    #[error("{}: {piece}: {what}", path.display())]
    Entry { path: PathBuf, piece: String, what: String },
    #[error("{}: {what}", path.display())]
    Shape { path: PathBuf, what: String },
    #[error("{}: frame {frame} holds a value that is no number", path.display())]
    NotFinite { path: PathBuf, frame: usize },
    #[error("{}: {problem}", path.display())]
    Pickle { path: PathBuf, problem: Problem },
    #[error("{}: {source}", path.display())]
    Motion { path: PathBuf, source: MotionError },
    #[error("{}: {source}", path.display())]
    Audio { path: PathBuf, source: AudioError },
    #[error("{}: {source}", path.display())]
    Features { path: PathBuf, source: FeatureError },
    #[error("{}: beats: {problem}", path.display())]
    Beats { path: PathBuf, problem: String },
    #[error("{}: {what}; with the audio file instead this can be computed", path.display())]
    StoredRows { path: PathBuf, what: &'static str },
    #[error(
        "`{train}` (train) and `{test}` (test) are the same motion: a model would be judged by \
         what it has seen"
    )]
    Leak { train: String, test: String },
    #[error("{}: no piece has the split `{split}`", path.display())]
    Empty { path: PathBuf, split: Split },
    #[error(
        "{} and {} do not have the same skeleton ({what}): data folders that are read together \
         need one",
        first.display(),
        other.display()
    )]
    Skeleton { first: PathBuf, other: PathBuf, what: String },
    #[error("{}: a data folder is there already: choose another --out", .0.display())]
    Exists(PathBuf),
    #[error("{}: no motion here: expected .bvh, .npz or .pkl files", .0.display())]
    NoMotion(PathBuf),
    #[error("{}: {} has the same name", path.display(), other.display())]
    SameName { path: PathBuf, other: PathBuf },
    #[error("--test {0}: no motion of this name is converted")]
    NoSuchTest(String),
    #[error("no data folder is named: give --data or data.folder")]
    NoFolder,
    #[error("feature cache {}: {source}; choose another folder with --cache", path.display())]
    Cache { path: PathBuf, source: std::io::Error },
    #[error(
        "neither XDG_CACHE_HOME nor HOME is set: choose a folder for the features with --cache"
    )]
    NoCacheFolder,
}
