//! Music in, dance out: 3-D dance generation after "Bailando: 3D Dance Generation by Actor-Critic
//! GPT with Choreographic Memory" (CVPR 2022), as an HTTP service.
//!
//! The service is three layers over the crates that it re-exports: [`engine`] schedules a
//! generation, [`options`] reads its options from text, [`server`] is HTTP only, [`mod@bench`]
//! measures both. The crates know nothing of the
//! service: [`audio`] (bytes to PCM) → [`features`] (PCM to 438 columns) → [`model`] (ONNX Runtime)
//! → [`motion`] (kinematics) → [`formats`] (JSON, BVH), and beside them [`evaluation`] and
//! [`codebook`].

pub mod bench;
pub mod engine;
#[doc(hidden)]
pub mod fuzzing;
pub mod options;
mod resident;
pub mod server;

pub use bailando_audio as audio;
pub use bailando_codebook as codebook;
pub use bailando_core::{CancelToken, npy};
pub use bailando_eval as evaluation;
pub use bailando_features as features;
pub use bailando_formats as formats;
pub use bailando_model as model;
pub use bailando_motion as motion;
