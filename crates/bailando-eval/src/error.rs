//! The crate's error.

use std::{
    io,
    path::{Path, PathBuf},
};

/// Why sets of motions could not be compared.
#[derive(Debug, thiserror::Error)]
pub enum EvaluationError {
    /// A file or folder could not be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file does not hold what it should.
    #[error("{}: {problem}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A motion can't be measured.
    #[error("motion {name}: {problem}")]
    Motion {
        /// Its name.
        name: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A generated motion's name is no piece of the reference folder.
    #[error(
        "{name} is no piece of {}: a generated file is named after its piece",
        reference.display()
    )]
    UnknownPiece {
        /// The file's stem.
        name: String,
        /// The reference folder.
        reference: PathBuf,
    },
    /// There are no music beats for a piece.
    #[error("no music beats for piece {piece}: {problem}")]
    Beats {
        /// The piece.
        piece: String,
        /// Where they were looked for.
        problem: String,
    },
    /// A covariance needs at least two samples.
    #[error("{set}: {got} {samples} can't be compared, at least 2 are needed")]
    TooFew {
        /// Which set.
        set: String,
        /// What is counted: motions or windows.
        samples: &'static str,
        /// How many there are.
        got: usize,
    },
    /// The plot can't be drawn.
    #[error("plot: {0}")]
    Plot(String),
    /// An option does not fit.
    #[error("{0}")]
    Option(String),
}

impl EvaluationError {
    pub(crate) fn io(path: &Path) -> impl Fn(io::Error) -> Self {
        |source| Self::Io { path: path.to_owned(), source }
    }

    pub(crate) fn file(path: &Path, problem: impl Into<String>) -> Self {
        Self::File { path: path.to_owned(), problem: problem.into() }
    }
}
