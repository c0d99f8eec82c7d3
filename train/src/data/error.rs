//! What can be wrong with training data.

use std::path::PathBuf;

use bailando::{audio::AudioError, features::FeatureError, motion::MotionError};

use super::Split;
use crate::checkpoint::Problem;

/// What can be wrong with training data: always one line that names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each message names its fields")]
pub enum DataError {
    /// A file or folder could not be read.
    #[error("{}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    /// A file is far larger than anything of its kind.
    #[error("{}: {bytes} bytes are more than the {limit} that such a file may \
             have", path.display())]
    TooLarge { path: PathBuf, bytes: u64, limit: u64 },
    /// A JSON file does not hold what its place in the layout asks for.
    #[error("{}: {source}", path.display())]
    Json { path: PathBuf, source: serde_json::Error },
    /// The folder has none of the known layouts.
    #[error(
        "{}: no training data here: expected index.json, or JSON files with dance_array, or .pkl \
         motions (also in motions/)",
        .0.display()
    )]
    Layout(PathBuf),
    /// An entry of the folder cannot be used.
    #[error("{}: {piece}: {what}", path.display())]
    Entry { path: PathBuf, piece: String, what: String },
    /// A motion or feature file's numbers do not have the expected form.
    #[error("{}: {what}", path.display())]
    Shape { path: PathBuf, what: String },
    /// A pickle is damaged, or asks for code.
    #[error("{}: {problem}", path.display())]
    Pickle { path: PathBuf, problem: Problem },
    /// Forward kinematics refused a motion.
    #[error("{}: {source}", path.display())]
    Motion { path: PathBuf, source: MotionError },
    /// A song could not be decoded.
    #[error("{}: {source}", path.display())]
    Audio { path: PathBuf, source: AudioError },
    /// A song's features could not be computed.
    #[error("{}: {source}", path.display())]
    Features { path: PathBuf, source: FeatureError },
    /// Stored rows are of another rate than asked for, or would have to be moved in time.
    #[error("{}: {what}; with the audio file instead this can be computed", path.display())]
    StoredRows { path: PathBuf, what: &'static str },
    /// The same motion is in both splits.
    #[error(
        "`{train}` (train) and `{test}` (test) are the same motion: a model would be judged by \
         what it has seen"
    )]
    Leak { train: String, test: String },
    /// A split has nothing in it.
    #[error("{}: no piece has the split `{split}`", path.display())]
    Empty { path: PathBuf, split: Split },
    /// The feature cache cannot be used.
    #[error("feature cache {}: {source}; choose another folder with --cache", path.display())]
    Cache { path: PathBuf, source: std::io::Error },
    /// There is nowhere to put the feature cache.
    #[error(
        "neither XDG_CACHE_HOME nor HOME is set: choose a folder for the features with --cache"
    )]
    NoCacheFolder,
}
