//! The stages of training, from data to a model directory.

mod adam;
mod chart;
mod codes;
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
mod songs;
mod state;
#[cfg(test)]
mod tests;
mod velocity;
mod vqvae;
mod whole;
mod windows;

pub use bailando::motion::MotionFrame;
pub use config::{Config, DataConfig, Keep, Schedule, TrainingConfig};
pub use device::{Stage, train};
pub use error::TrainError;
pub use export::{export, trained_weights};
pub use input::{Dances, Load, MotionPiece, MotionSet, SongRows};
pub use runner::{Limits, Outcome};
pub use whole::run_all;

use crate::data::FRAMES_PER_CODE;
