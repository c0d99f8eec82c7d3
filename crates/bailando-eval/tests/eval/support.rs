//! Motions and checks for the tests of the evaluation.

use std::path::Path;

use bailando_eval::{BeatsFrom, Clips, EvaluationOptions, KineticForm, Motion};
use ndarray::{Array2, Array3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Frames of a piece that the golden values look at.
const GOLDEN_FRAMES: usize = 1_200;

pub(crate) fn close(got: f64, expected: f64, relative: f64, what: &str) {
    let error = (got - expected).abs();
    assert!(error <= relative * expected.abs(), "{what}: {got}, expected {expected}");
}

pub(crate) fn json(path: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap()
}

pub(crate) fn rows(path: &Path) -> Array2<f32> {
    ndarray_npy::read_npy(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

pub(crate) fn random() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

/// A motion played backwards, last frame first, then cut to what the golden values look at.
pub(crate) fn reversed(motion: &Motion) -> (Motion, Array3<f32>) {
    let poses: Vec<_> = motion.poses().iter().rev().take(GOLDEN_FRAMES).collect();
    let positions = Array3::from_shape_fn((poses.len(), 24, 3), |(frame, joint, axis)| {
        poses[frame][joint][axis] as f32
    });
    (Motion::new(motion.name(), positions.view()).unwrap(), positions)
}

/// The published protocol between two folders.
pub(crate) fn options(generated: &Path, reference: &Path) -> EvaluationOptions {
    EvaluationOptions {
        generated: generated.to_owned(),
        reference: reference.to_owned(),
        split: None,
        beats: BeatsFrom::default(),
        clips: Clips::default(),
        kinetic: KineticForm::Published,
        seeds: None,
        styles_from: Vec::new(),
        style: None,
        form: false,
        chance_seed: 0,
    }
}
