//! Seconds per training step on a CPU of both halves of a pose VQ-VAE (width 256, 32 x 240 frames)
//! and of a motion GPT (6 blocks of 256 channels, 32 x 29 codes), on made-up motion. Prints one
//! JSON object; `scripts/compare-with-torch.sh` puts it beside PyTorch's. `RAYON_NUM_THREADS` sets
//! the threads.

#![allow(clippy::print_stdout, reason = "a benchmark's figures are its output")]

use std::{sync::Arc, time::Instant};

use anyhow::Context;
use bailando_train::training::{
    Config, Limits, MotionPiece, MotionSet, Motions, SongRows, Stage, train,
};
use ndarray::{Array2, Array3};

const SETTINGS: &str = r#"
[vqvae]
width = 256
embedding = 256
codes = 256
[vqvae.training]
batch = 32
steps = 1000
clip = 1.0
[gpt]
channels = 256
heads = 8
base_layers = 3
head_layers = 3
dropout = 0.1
[gpt.training]
batch = 32
steps = 1000
clip = 1.0
[run]
checkpoint_seconds = 1e9
log_steps = 1000
"#;
/// Steps before the clock starts, and steps that it counts.
const STEPS: [u64; 2] = [2, 12];

fn main() -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let mut config = Config::parse(SETTINGS).map_err(anyhow::Error::msg)?;
    config.run.folder = folder.path().to_owned();
    let set = motion_set(&config)?;
    let vqvae = seconds(Stage::VqVae, &config, &set)?;
    // The GPT wants a finished VQ-VAE: its codes, not its quality, are what a step costs.
    config.run.folder = folder.path().join("finished");
    config.vqvae.training.steps = 1;
    train(Stage::VqVae, &config, &set, None, Limits::default(), &mut Vec::new())?;
    let gpt = seconds(Stage::Gpt, &config, &set)?;
    println!("{}", serde_json::json!({ "vqvae": vqvae, "gpt": gpt }));
    Ok(())
}

/// Time of the counted steps, starting and saving left out by a run without them.
fn seconds(stage: Stage, config: &Config, set: &MotionSet) -> anyhow::Result<f64> {
    let mut times = Vec::new();
    for steps in STEPS {
        let start = Instant::now();
        let limits = Limits { steps: Some(steps), ..Limits::default() };
        train(stage, config, set, None, limits, &mut Vec::new())?;
        times.push(start.elapsed().as_secs_f64());
        let checkpoint = config.run.folder.join(stage.name());
        std::fs::remove_dir_all(&checkpoint).context("the stage's folder")?;
    }
    Ok((times[1] - times[0]) / (STEPS[1] - STEPS[0]) as f64)
}

/// A minute of swinging joints, and music that follows the same clock.
fn motion_set(config: &Config) -> anyhow::Result<MotionSet> {
    let positions = Array3::from_shape_fn((3_600, 24, 3), |(frame, joint, axis)| {
        let time = frame as f32 / 60.0;
        0.05 * joint as f32 * (time * (2.0 + (joint % 4) as f32) + axis as f32).sin()
    });
    let music =
        Array2::from_shape_fn((451, 438), |(row, column)| (row as f32 / 7.5 + column as f32).cos());
    let piece = MotionPiece::from_positions(positions, config.data.frame)?;
    let song = SongRows::new(vec![Arc::new(music)]).context("a song")?;
    Ok(MotionSet::new(Motions::new(vec![piece.with_song(song)]), None))
}
