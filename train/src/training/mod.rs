//! The stages of training, from data to a model directory.

mod ablation;
mod actor_critic;
mod adam;
mod adapt;
mod calibrate;
mod chart;
mod codes;
mod config;
mod decode;
mod device;
mod error;
mod export;
mod generate;
mod gpt;
#[cfg(test)]
mod init_tests;
mod input;
mod keep;
mod lesson;
mod metrics;
mod music_scale;
mod plots;
mod policy;
mod progress;
mod reward;
mod rollout;
mod runner;
#[cfg(test)]
mod runner_tests;
mod sampling;
mod saved;
mod slips;
mod song;
mod songs;
mod stage;
mod state;
mod suppress;
#[cfg(test)]
mod tests;
mod velocity;
mod vqvae;
mod whole;
mod windows;

pub use ablation::AblationConfig;
pub use adapt::{Adaptation, adapt, export_adapted};
pub use bailando::motion::MotionFrame;
pub use config::{Config, DataConfig, Keep, Schedule, TrainingConfig};
pub use device::train;
pub use error::TrainError;
pub use export::{export, trained_weights};
pub use generate::generate_test_dances;
pub use input::{Dances, Load, MotionPiece, MotionSet, SongRows};
pub use reward::{BeatReward, Reward, RewardRule};
pub use runner::{Limits, Outcome};
pub use song::{Song, target_song};
pub use stage::Stage;
pub use whole::run_all;

use crate::data::FRAMES_PER_CODE;
