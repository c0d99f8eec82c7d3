//! Model directories from training data, or from official checkpoints.
//!
//! [`checkpoint`] (a file to tensors) → [`weights`] (tensors to networks) → [`onnx`] (networks
//! to graphs) → [`export`] (graphs and manifest to a model directory). [`import`] does it all,
//! [`training`] makes weights of [`data`], [`encode`] runs recordings through a model,
//! [`music_gap`] measures its conditioning on the music, [`mod@compare`] the loss by quantisation,
//! and [`cli`] is the command line.

pub mod checkpoint;
pub mod cli;
pub mod compare;
pub mod data;
pub mod encode;
pub mod export;
#[doc(hidden)]
pub mod fuzzing;
pub mod held_out;
mod host_tensor;
pub mod import;
pub mod music_gap;
pub mod nn;
pub mod onnx;
pub mod training;
pub mod trial;
pub mod weights;

pub use host_tensor::{HostTensor, ShapeMismatch};

/// Returns the SHA-256 of some bytes in hexadecimal digits.
#[expect(clippy::expect_used, reason = "reading from memory does not fail")]
fn sha256(mut bytes: &[u8]) -> String {
    bailando::model::file_sha256(&mut bytes).expect("reading from memory")
}
