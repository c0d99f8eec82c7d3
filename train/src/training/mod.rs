//! The stages of training, from data to a model directory.

mod adam;
mod codes;
mod config;
mod device;
mod error;
mod export;
mod gpt;
mod input;
mod runner;
mod saved;
mod songs;
#[cfg(test)]
mod tests;
mod velocity;
mod vqvae;
mod windows;

pub use config::{Config, DataConfig, Schedule, TrainingConfig};
pub use device::{Stage, train};
pub use error::TrainError;
pub use export::{export, trained_weights};
pub use input::{Dances, Load, MotionPiece, MotionSet, SongRows};
pub use runner::{Limits, Outcome};

use crate::data::FRAMES_PER_CODE;
