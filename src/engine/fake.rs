//! A model and a decoder for unit tests: small, exact, and faulty on demand.

use std::{
    fs,
    hash::{DefaultHasher, Hash, Hasher},
    ops::Range,
    sync::Arc,
};

use bailando_testkit::{model::tiny, read_json};
use ndarray::{Array2, Array3, ArrayView1};
use parking_lot::Mutex;
use serde_json::json;
use tempfile::TempDir;

use super::code_model::{CodeModel, MotionDecoder};
use crate::model::{Logits, ModelDirectory, ModelError, NextStep, Steps, file_sha256};

/// Codes of either half.
pub(super) const VOCABULARY: usize = 16;
/// Longest history of a step.
const CONTEXT: usize = 28;

/// A directory whose manifest describes the fakes; its graphs are none.
pub(super) fn directory() -> (TempDir, Arc<ModelDirectory>) {
    const GRAPH: &[u8] = b"no graph";
    let folder = tempfile::tempdir().unwrap();
    let mut manifest = read_json(&tiny().join("manifest.json"));
    manifest["files"] = json!({});
    manifest["decoder"]["receptive_codes"] = json!(4);
    manifest["sampling"] = json!({ "temperature": 1.0, "window": "hop", "hop": 15 });
    for name in ["gpt.onnx", "decoder.onnx", "encoder.onnx"] {
        fs::write(folder.path().join(name), GRAPH).unwrap();
        let sha256 = file_sha256(&mut &*GRAPH).unwrap();
        manifest["files"][name] = json!({ "bytes": GRAPH.len(), "sha256": sha256 });
    }
    fs::write(folder.path().join("manifest.json"), manifest.to_string()).unwrap();
    let directory = ModelDirectory::open(folder.path()).unwrap();
    (folder, Arc::new(directory))
}

/// What a [`FakeModel`] has done, and what it shall do.
#[derive(Debug, Default)]
pub(super) struct Script {
    /// Rows of each step.
    pub(super) steps: Vec<usize>,
    /// The next step fails.
    pub(super) fail_step: bool,
    /// Prefills beside music that begins with this value fail.
    pub(super) fail_prefill: Option<f32>,
    /// Rows beside music that begins with this value have logits that are no numbers.
    pub(super) no_numbers: Option<f32>,
}

/// A model whose logits depend on all codes of the window and on the newest music, so that a row
/// that is mixed up with another shows in the codes.
pub(super) struct FakeModel {
    rows: Vec<Vec<[u32; 2]>>,
    pub(super) script: Arc<Mutex<Script>>,
}

impl FakeModel {
    pub(super) fn new(rows: usize) -> Self {
        Self { rows: vec![Vec::new(); rows], script: Arc::default() }
    }
}

fn failure(problem: &str) -> ModelError {
    ModelError::Run { graph: "fake", problem: problem.to_owned() }
}

fn logits(window: &[[u32; 2]], music: ArrayView1<'_, f32>, half: usize) -> Vec<f32> {
    let bits = [music[0], music[1]].map(f32::to_bits);
    let logit = |code: usize| {
        let mut hasher = DefaultHasher::new();
        (window, bits, half, code).hash(&mut hasher);
        (hasher.finish() % 1000) as f32 / 250.0
    };
    (0..VOCABULARY).map(logit).collect()
}

impl CodeModel for FakeModel {
    fn rows(&self) -> usize {
        self.rows.len()
    }

    fn clear(&mut self, row: usize) {
        self.rows[row].clear();
    }

    fn copy(&mut self, from: Range<usize>, to: usize) {
        let rows = self.rows[from.clone()].to_vec();
        self.rows[to..to + from.len()].clone_from_slice(&rows);
    }

    fn prefill(&mut self, row: usize, steps: Steps<'_>) -> Result<(), ModelError> {
        self.rows[row].clear();
        if self.script.lock().fail_prefill == Some(steps.music[[0, 0]]) {
            return Err(failure("no prefill"));
        }
        assert_eq!(steps.codes.len(), steps.music.nrows());
        assert!(steps.codes.len() < CONTEXT, "a prefill fits a row");
        self.rows[row].extend(steps.codes);
        Ok(())
    }

    fn step(&mut self, next: &[NextStep<'_>]) -> Result<Logits, ModelError> {
        let mut script = self.script.lock();
        if std::mem::take(&mut script.fail_step) {
            return Err(failure("no step"));
        }
        script.steps.push(next.len());
        let mut halves = [Vec::new(), Vec::new()];
        for (row, step) in self.rows.iter_mut().zip(next) {
            row.push(step.codes);
            for (half, found) in halves.iter_mut().enumerate() {
                let mut logits = logits(row, step.music, half);
                if script.no_numbers == Some(step.music[0]) {
                    logits.fill(f32::NAN);
                }
                found.extend(logits);
            }
            // As the cache: a full row stays as it is.
            row.truncate(CONTEXT - 1);
        }
        let [upper, lower] =
            halves.map(|half| Array2::from_shape_vec((next.len(), VOCABULARY), half).unwrap());
        Ok(Logits { upper, lower })
    }
}

/// A decoder whose frames stand at the numbers of their codes.
pub(super) struct FakeDecoder {
    pub(super) columns: usize,
    /// The value that every frame ends with.
    pub(super) last: f32,
}

impl MotionDecoder for FakeDecoder {
    fn decode_batch(&mut self, sequences: &[&[[u32; 2]]]) -> Result<Array3<f32>, ModelError> {
        let shape = (sequences.len(), 8 * sequences[0].len(), self.columns);
        Ok(Array3::from_shape_fn(shape, |(sequence, frame, column)| {
            let pair = sequences[sequence][frame / 8];
            match column + 1 == self.columns {
                true => self.last,
                false => pair[column % 2] as f32 * 0.01,
            }
        }))
    }
}
