//! The stages of training, from data to a model directory.

mod adam;
mod chart;
mod config;
mod device;
mod error;
mod export;
mod gpt;
mod input;
mod keep;
mod metrics;
mod plots;
mod progress;
mod runner;
#[cfg(test)]
mod runner_tests;
mod saved;
mod state;
mod velocity;
mod vqvae;
mod whole;
mod windows;

pub use config::{Config, Keep, Schedule, TrainingConfig};
pub use device::{Stage, train};
pub use error::TrainError;
pub use export::{export, trained_weights};
pub use input::{Load, MotionPiece, MotionSet};
pub use runner::{Limits, Outcome};
pub use whole::run_all;

/// Motion frames of a code.
const FRAMES_PER_CODE: usize = 8;
