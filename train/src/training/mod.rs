//! The stages of training, from data to a model directory.

mod ablation;
mod actor_critic;
mod adam;
mod adapt;
mod calibrate;
mod chart;
mod checkpoint;
mod codes;
mod config;
mod crops;
mod decode;
mod device;
mod error;
mod export;
mod files;
mod frozen;
mod generate;
mod gpt;
mod identity;
#[cfg(test)]
mod init_tests;
mod input;
mod kept;
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
mod song;
mod songs;
mod stage;
mod state;
mod stop;
mod suppress;
#[cfg(test)]
mod tests;
mod time_shift;
mod train;
mod trainable;
mod trajectory_batch;
mod velocity;
mod vqvae;
mod whole;
mod windows;

pub use adapt::{Adaptation, adapt, export_adapted};
pub use bailando::motion::MotionFrame;
pub use config::{AblationConfig, CheckpointPolicy, Config, DataConfig, Schedule, TrainingConfig};
pub use error::TrainError;
pub use export::{export, trained_weights};
pub use generate::generate_test_motions;
pub use input::{MotionPiece, MotionSet, Motions};
pub use reward::{BeatReward, Reward, RewardRule};
pub use runner::{Limits, Outcome};
pub use song::{Song, target_song};
pub use songs::SongRows;
pub use stage::{Load, Stage};
pub use stop::StopFlag;
pub use train::train;
pub use whole::run_all;
