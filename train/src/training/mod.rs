//! The stages of training, from data to a model directory.

mod actor_critic;
mod adam;
mod adapt;
mod config;
mod decode;
mod device;
mod error;
mod export;
mod gpt;
mod input;
mod lesson;
mod policy;
mod reward;
mod rollout;
mod runner;
mod sampling;
mod saved;
mod songs;
mod velocity;
mod vqvae;
mod windows;

pub use adapt::{Adaptation, adapt, export_adapted};
pub use config::{Config, Schedule, TrainingConfig};
pub use device::{Stage, actor_critic, train};
pub use error::TrainError;
pub use export::{export, trained_weights};
pub use input::{Load, MotionPiece, MotionSet};
pub use reward::{BeatReward, Reward, RewardRule};
pub use runner::{Limits, Outcome};
pub use songs::Song;

/// Motion frames of a code.
const FRAMES_PER_CODE: usize = 8;
