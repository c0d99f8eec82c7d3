//! The inputs of a bench.

use std::path::PathBuf;

use bytes::Bytes;

use crate::model::Device;

/// The model, the song and the extent of a bench.
#[derive(Clone, Debug)]
pub struct BenchOptions {
    /// The model directory.
    pub model_dir: PathBuf,
    /// What computes the model.
    pub device: Device,
    /// The song, as uploaded.
    pub song: Bytes,
    /// Numbers of threads that steps are measured with; everything else uses the last one.
    pub threads: Vec<usize>,
    /// Repetitions of each stage, of which the median counts.
    pub repeats: usize,
    /// Lengths in seconds that the song is repeated to.
    pub lengths_s: Vec<f64>,
    /// Numbers of callers that generate at the same time.
    pub callers: Vec<usize>,
    /// Codes of each motion in the comparison of eight at once with one after another.
    pub batch_codes: usize,
}
