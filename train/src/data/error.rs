//! What can be wrong with training data.

use std::path::PathBuf;

use bailando::{audio::AudioError, features::FeatureError, motion::MotionError};

use super::Split;
use crate::checkpoint::Problem;

/// What can be wrong with training data: always one line that names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DataError {
    /// A file or folder could not be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file is far larger than anything of its kind.
    #[error("{}: {bytes} bytes are more than the {limit} that such a file may \
             have", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
        /// The limit.
        limit: u64,
    },
    /// A JSON file does not hold what its place in the layout asks for.
    #[error("{}: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Where it does not.
        source: serde_json::Error,
    },
    /// The folder has none of the known layouts.
    #[error(
        "{}: no training data here: expected index.json, or JSON files with dance_array, or .pkl \
         motions (also in motions/)",
        .0.display()
    )]
    Layout(PathBuf),
    /// An entry of the folder cannot be used.
    #[error("{}: {piece}: {what}", path.display())]
    Entry {
        /// The folder or its index.
        path: PathBuf,
        /// Which piece.
        piece: String,
        /// What is wrong with it.
        what: String,
    },
    /// A motion or feature file's numbers do not have the expected form.
    #[error("{}: {what}", path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// Expected and found.
        what: String,
    },
    /// A pickle is damaged, or asks for code.
    #[error("{}: {problem}", path.display())]
    Pickle {
        /// The file.
        path: PathBuf,
        /// What is wrong inside it.
        problem: Problem,
    },
    /// Forward kinematics refused a motion.
    #[error("{}: {source}", path.display())]
    Motion {
        /// The file.
        path: PathBuf,
        /// Why.
        source: MotionError,
    },
    /// A song could not be decoded.
    #[error("{}: {source}", path.display())]
    Audio {
        /// The file.
        path: PathBuf,
        /// Why.
        source: AudioError,
    },
    /// A song's features could not be computed.
    #[error("{}: {source}", path.display())]
    Features {
        /// The file.
        path: PathBuf,
        /// Why.
        source: FeatureError,
    },
    /// Stored rows are of another rate than asked for, or would have to be moved in time.
    #[error("{}: {what}; with the audio file instead this can be computed", path.display())]
    StoredRows {
        /// The file.
        path: PathBuf,
        /// What is not possible.
        what: &'static str,
    },
    /// The same motion is in both splits.
    #[error(
        "`{train}` (train) and `{test}` (test) are the same motion: a model would be judged by \
         what it has seen"
    )]
    Leak {
        /// A file of the training split.
        train: String,
        /// A file of the test split.
        test: String,
    },
    /// A split has nothing in it.
    #[error("{}: no piece has the split `{split}`", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
        /// The split.
        split: Split,
    },
    /// The feature cache cannot be used.
    #[error("feature cache {}: {source}; choose another folder with --cache", path.display())]
    Cache {
        /// The folder or file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// There is nowhere to put the feature cache.
    #[error(
        "neither XDG_CACHE_HOME nor HOME is set: choose a folder for the features with --cache"
    )]
    NoCacheFolder,
}
