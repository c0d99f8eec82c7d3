//! The three graphs of a model directory, written as ONNX from the weights alone.
//!
//! Shapes are named and dynamic; weights are stored as float32, or as float16 that is widened when
//! the graph is loaded. Computation is in float32, but for the GPT's products with 8-bit matrices.

mod builder;
mod decoder;
mod encoder;
mod gpt;
mod proto;
mod quantise;
mod ranges;
mod read;
mod receptive;

pub use decoder::decoder_graph;
pub use encoder::encoder_graph;
pub use gpt::gpt_graph;
pub use ranges::InputRanges;
pub use read::GraphWeights;
pub use receptive::receptive_codes;

/// Why a graph could not be written.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages are the documentation")]
pub enum GraphError {
    #[error("weight `{weight}` holds {value}, beyond the range of float16: use --weights f32")]
    HalfRange { weight: String, value: f32 },
}
