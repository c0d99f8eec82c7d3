//! The stages of training, from data to a model directory.

mod adam;
mod config;
mod device;
mod error;
mod export;
mod gpt;
mod input;
mod runner;
mod saved;
mod velocity;
mod vqvae;
mod windows;

pub use config::{Config, Schedule, TrainingConfig};
pub use device::{Stage, train};
pub use error::TrainError;
pub use export::{export, trained_weights};
pub use input::{Load, MotionPiece, MotionSet};
pub use runner::{Limits, Outcome};

/// Motion frames of a code.
const FRAMES_PER_CODE: usize = 8;
