//! Music in, dance out: 3-D dance generation after "Bailando: 3D Dance Generation by Actor-Critic
//! GPT with Choreographic Memory" (CVPR 2022), as a library and an HTTP service.
//!
//! One direction: [`audio`] (bytes to PCM) → [`features`] (PCM to 438 columns) → [`model`] (the
//! only module that knows ONNX Runtime) → [`motion`] (skeleton, kinematics) → [`mod@format`] (JSON,
//! BVH). [`engine`] schedules a generation, [`server`] is HTTP only, [`evaluation`] measures dances,
//! [`codebook`] shows what a model's codes look like, [`mod@bench`] how fast all of this is, [`npy`] reads
//! NumPy files.

pub mod audio;
pub mod bench;
pub mod cancel;
pub mod codebook;
mod dsp;
pub mod engine;
pub mod error;
pub mod evaluation;
pub mod features;
pub mod format;
#[doc(hidden)]
pub mod fuzzing;
pub mod model;
pub mod motion;
pub mod npy;
mod resident;
pub mod server;

pub use cancel::CancelToken;
pub use error::{Error, Result};
