//! Checkpoints to model directories; later, training.

pub mod checkpoint;
pub mod onnx;
mod tensor;
pub mod weights;

pub use tensor::{ShapeMismatch, Tensor};
