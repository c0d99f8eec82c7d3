//! Helpers of the integration tests.

pub(crate) mod dancer;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::{Mutex, MutexGuard, PoisonError},
};

use bailando::{
    features::Profile,
    model::{CountSource, ModelDirectory, SuppressedCodes, WeightStorage},
    motion::MotionFrame,
};
use bailando_train::{
    checkpoint::TorchCheckpoint,
    export::{Description, PUBLISHED_HOP},
    import::{ImportOptions, import},
    weights::{GptWeights, VqVaeWeights},
};
use ndarray::Array3;
use tempfile::TempDir;

pub(crate) use bailando_testkit::arrays::{assert_close, codes, floats, rows};

/// Largest absolute difference that float32 results may have (ARCHITECTURE section 5).
pub(crate) const TOLERANCE: f32 = 2e-5;
/// Heads of the golden models.
pub(crate) const HEADS: usize = 4;

/// Path of a golden file that the repository owns.
pub(crate) fn fixture(name: &str) -> PathBuf {
    bailando_testkit::fixture("model").join(name)
}

/// The pose VQ-VAE of the golden models.
pub(crate) fn vqvae() -> VqVaeWeights {
    let mut checkpoint = TorchCheckpoint::open(&fixture("tiny_vqvae.pt")).unwrap();
    VqVaeWeights::from_checkpoint(&mut checkpoint).unwrap()
}

/// The motion GPT of the golden models.
pub(crate) fn gpt() -> GptWeights {
    let mut checkpoint = TorchCheckpoint::open(&fixture("tiny_gpt.pt")).unwrap();
    GptWeights::from_checkpoint(&mut checkpoint, HEADS).unwrap()
}

/// Runs the trainer's binary.
pub(crate) fn train(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bailando-train"))
        .args(arguments)
        .env_remove("COLUMNS")
        .output()
        .unwrap()
}

/// Standard output of a process.
pub(crate) fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Held by tests that draw from the CPU backend's random generator, which a process has once.
pub(crate) fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Import options of the golden models.
pub(crate) fn options(vqvae: &Path, gpt: &Path, out: &Path) -> ImportOptions {
    ImportOptions {
        vqvae: vqvae.to_owned(),
        gpt: gpt.to_owned(),
        out: out.to_owned(),
        replace: false,
        heads: HEADS,
        start_codes: None,
        training: None,
        description: Description {
            name: "tiny".into(),
            licence: "MIT".into(),
            profile: Profile::Librosa081,
            count_periods: Vec::new(),
            counts: CountSource::default(),
            styles: Vec::new(),
            energy: false,
            classifier: None,
            start_codes: Vec::new(),
            style_start_codes: BTreeMap::new(),
            style_codes: BTreeMap::new(),
            suppressed_codes: SuppressedCodes::default(),
            temperature: 0.0,
            guidance: 1.0,
            candidates: 1,
            redo: false,
            hop: PUBLISHED_HOP,
            motion_frame: MotionFrame::World,
            root_height: 0.93,
            weights: WeightStorage::F32,
            training: Default::default(),
        },
    }
}

/// An imported model that vanishes with the guard.
pub(crate) fn imported(mut change: impl FnMut(&mut ImportOptions)) -> (TempDir, ModelDirectory) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("model");
    let mut options = options(&fixture("tiny_vqvae.pt"), &fixture("tiny_gpt.pt"), &out);
    change(&mut options);
    import(&options).unwrap();
    let directory = ModelDirectory::open(&out).unwrap();
    (folder, directory)
}

/// 8 seconds of joints that swing at different rates while the root walks.
pub(crate) fn swinging(phase: f32) -> Array3<f32> {
    Array3::from_shape_fn((480, 24, 3), |(frame, joint, axis)| {
        let time = frame as f32 / 60.0 + phase;
        let swing = (time * (2.0 + (joint % 4) as f32) + axis as f32).sin();
        0.05 * joint as f32 * swing + 0.3 * (time + axis as f32).sin()
    })
}
