//! What can be wrong with a model directory or with ONNX Runtime.

use std::{error::Error, fmt, path::PathBuf};

/// What can be wrong with a model directory or with ONNX Runtime. Messages are one line.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A file could not be read.
    #[error("{}: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why; not a `source`, because the message holds it already.
        reason: std::io::Error,
    },
    /// The folder is not a model directory.
    #[error("{}: there is no such file: name a model directory with --model-dir", path.display())]
    NoModel {
        /// The manifest that was looked for.
        path: PathBuf,
    },
    /// `manifest.json` is not a manifest, or `styles.json` no classifier of its styles.
    #[error("{}: not what this version reads: {problem}", path.display())]
    Manifest {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        problem: String,
    },
    /// A file of the directory is a link to something outside of it.
    #[error("{}: this link leads out of the model directory", path.display())]
    Outside {
        /// The link.
        path: PathBuf,
    },
    /// A file is not the one its manifest describes.
    #[error("{}: {what} is {found}, the manifest says {expected}", path.display())]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// Which property differs.
        what: &'static str,
        /// The manifest's value.
        expected: String,
        /// The file's value.
        found: String,
    },
    /// The ONNX Runtime library was not found or could not be used.
    #[error("ONNX Runtime: {0}")]
    Runtime(String),
    /// A device cannot be used.
    #[error("{device}: {problem}")]
    Device {
        /// The device, as it was asked for.
        device: String,
        /// Why, and what to do.
        problem: String,
    },
    /// A file is not a graph that is read from a model directory.
    #[error("{}: not a graph this version reads: {problem}", path.display())]
    GraphFile {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        problem: String,
    },
    /// A graph could not be loaded.
    #[error("{}: ONNX Runtime refuses the graph: {problem}", path.display())]
    Graph {
        /// The file.
        path: PathBuf,
        /// The runtime's reason.
        problem: String,
    },
    /// A graph could not be run.
    #[error("running {graph} failed: {problem}")]
    Run {
        /// Which graph.
        graph: &'static str,
        /// The runtime's reason.
        problem: String,
    },
    /// An input does not fit the model.
    #[error("{what}: expected {expected}, got {got}")]
    Input {
        /// Which input.
        what: &'static str,
        /// What fits.
        expected: String,
        /// What was given.
        got: String,
    },
}

/// ONNX Runtime's reasons run over several lines; ours are one.
pub(super) fn one_line(error: &impl fmt::Display) -> String {
    error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The system's loader in its own words: the error itself only says that it is one.
pub(super) fn loader_reason(error: &dyn Error) -> String {
    error.source().map_or_else(|| one_line(&error), |source| one_line(&source))
}
