//! `bailando evaluate`: generated dances against recordings.

use std::{fs, num::NonZeroUsize, path::PathBuf};

use anyhow::Context;
use bailando::evaluation::{BeatsFrom, Clips, EvaluationOptions, KineticForm, evaluate};
use clap::ValueEnum;

use super::{say, say_error};

/// Compare generated dances with recordings: FID, diversity, beat align score and more
#[derive(Debug, clap::Args)]
pub(super) struct EvaluateArgs {
    /// Generated motions (.npy [frames, 24, 3], .json, .bvh), each named after its piece
    #[arg(long, value_name = "DIR")]
    generated: PathBuf,
    /// Recordings: a data folder with index.json, or a folder of motions
    #[arg(long, value_name = "DIR")]
    reference: PathBuf,
    /// Audio files by piece: music beats are column 53 of their features
    #[arg(long, value_name = "DIR", conflicts_with = "beats")]
    music: Option<PathBuf>,
    /// Audio files of songs that are no pieces of the reference, which generated dances are named after
    #[arg(long, value_name = "DIR", conflicts_with_all = ["beats", "music", "split"])]
    new_songs: Option<PathBuf>,
    /// Music beats: {"beats": {piece or audio file: [frame, ..]}}, frames at 60 a second
    #[arg(long, value_name = "F.json")]
    beats: Option<PathBuf>,
    /// Generated pieces of this split only; the reference's row is of it, too [default row: test]
    #[arg(long)]
    split: Option<String>,
    /// Sample windows of this many frames instead of the first 1200 of each motion
    #[arg(long, value_name = "FRAMES")]
    window: Option<usize>,
    /// Frames from one window to the next [default: half a window]
    #[arg(long, value_name = "FRAMES", requires = "window")]
    stride: Option<usize>,
    /// --generated holds this many folders, one per seed: their mean with 95 % intervals
    #[arg(long, value_name = "N")]
    seeds: Option<NonZeroUsize>,
    /// Acceleration in kinetic features: as published, or corrected (not comparable)
    #[arg(long, value_enum, default_value = "published")]
    kinetic: KineticArg,
    /// Seed of the random shifts behind the beat score's chance level
    #[arg(long, default_value_t = 0)]
    chance_seed: u64,
    /// Print JSON instead of a Markdown table
    #[arg(long)]
    json: bool,
    /// Write a plot of generated relative to recorded, too
    #[arg(long, value_name = "OUT.svg")]
    plot: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum KineticArg {
    Published,
    Corrected,
}

impl EvaluateArgs {
    fn options(&self) -> EvaluationOptions {
        EvaluationOptions {
            generated: self.generated.clone(),
            reference: self.reference.clone(),
            split: self.split.clone(),
            beats: match (&self.beats, &self.music, &self.new_songs) {
                (Some(file), ..) => BeatsFrom::File(file.clone()),
                (None, Some(folder), _) => BeatsFrom::Audio(folder.clone()),
                (None, None, Some(folder)) => BeatsFrom::NewSongs(folder.clone()),
                (None, None, None) => BeatsFrom::Reference,
            },
            clips: match self.window {
                None => Clips::default(),
                Some(length) => Clips::Windows {
                    length,
                    stride: self.stride.unwrap_or(length / 2),
                },
            },
            kinetic: match self.kinetic {
                KineticArg::Published => KineticForm::Published,
                KineticArg::Corrected => KineticForm::Corrected,
            },
            seeds: self.seeds,
            chance_seed: self.chance_seed,
        }
    }
}

pub(super) fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    let report = evaluate(&args.options())?;
    if let Some(path) = &args.plot {
        let svg = report.svg()?;
        fs::write(path, svg).with_context(|| path.display().to_string())?;
    }
    if args.json {
        for warning in &report.warnings {
            say_error(&format!("warning: {warning}"));
        }
        say(&serde_json::to_string_pretty(&report)?);
    } else {
        say(report.markdown().trim_end());
    }
    Ok(())
}
