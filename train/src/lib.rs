//! Training, from data to model directories; and checkpoints of others to model directories.
//!
//! [`checkpoint`] (a file to tensors) → [`weights`] (tensors to networks) → [`onnx`] (networks to
//! graphs) → [`export`] (graphs and manifest to a model directory). [`import`] goes all the way,
//! [`training`] makes weights of [`data`], [`encode`] sends recordings through a model, [`music_gap`]
//! says whether it hears, [`mod@compare`] what quantisation costs it, [`cli`] parses and prints.

pub mod checkpoint;
pub mod cli;
pub mod compare;
pub mod data;
pub mod encode;
pub mod export;
#[doc(hidden)]
pub mod fuzzing;
pub mod held_out;
pub mod import;
pub mod music_gap;
pub mod nn;
pub mod onnx;
mod tensor;
pub mod training;
pub mod weights;

pub use tensor::{ShapeMismatch, Tensor};
