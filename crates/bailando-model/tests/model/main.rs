//! The model crate as others use it: golden values, and directories that are not what they say.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "tests stop where something is not as it should be, and report what they measured"
)]

mod beats;
mod decoder;
mod directory;
mod gpt;
#[cfg(unix)]
mod strangers;

use std::{ops::Range, path::PathBuf};

use bailando_model::{ModelDirectory, code_pairs};
use bailando_testkit::{
    arrays::{codes, floats},
    fixture,
    model::tiny,
};
use ndarray::Array2;

/// Largest absolute difference that float32 results may have (ARCHITECTURE section 5).
const TOLERANCE: f32 = 2e-5;

/// One of the two golden samplings.
struct Sampling {
    name: &'static str,
    /// Codes kept when the window moves.
    kept: usize,
    /// File of the motion that its codes decode to.
    motion: &'static str,
}

const SAMPLINGS: [Sampling; 2] = [
    Sampling { name: "slide", kept: 28, motion: "decode_raw.npy" },
    Sampling { name: "shift15", kept: 15, motion: "decode_raw_shift15.npy" },
];

impl Sampling {
    fn codes(&self) -> Vec<[u32; 2]> {
        let half = |half: &str| codes(&golden(&format!("codes_{}_{half}.npy", self.name)));
        code_pairs(&half("up"), &half("down")).unwrap()
    }
}

/// Path of a golden file.
fn golden(name: &str) -> PathBuf {
    fixture("model").join(name)
}

/// The model of the golden checkpoints.
fn directory() -> ModelDirectory {
    ModelDirectory::open(&tiny()).unwrap()
}

/// The golden music of some codes: the reference drops the first row.
fn music(codes: Range<usize>) -> Array2<f32> {
    let music = floats(&golden("music.npy"));
    bailando_testkit::arrays::rows(&music, codes.start + 1..codes.end + 1).to_owned()
}
