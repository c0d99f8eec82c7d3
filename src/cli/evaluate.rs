//! `bailando evaluate`: generated motion against recordings.

use std::{num::NonZeroUsize, path::PathBuf};

use bailando::evaluation::{BeatsFrom, Clips, EvaluationOptions, KineticForm, evaluate};
use clap::ValueEnum;

use super::console::{at_least_one, say, say_error, write_file};

/// Compare generated motion with recordings: FID, diversity, beat align score and more
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct EvaluateArgs {
    /// Folder of generated motions (.npy [frames, 24, 3], .json, .bvh), each named after its song's
    /// piece in the reference
    #[arg(long, value_name = "DIR")]
    generated: PathBuf,
    /// Recordings: a data folder with index.json, or a folder of motions
    #[arg(long, value_name = "DIR")]
    reference: PathBuf,
    /// Folder of audio files, named like the pieces, in which the music's beats are found
    #[arg(long, value_name = "DIR", conflicts_with = "beats")]
    music: Option<PathBuf>,
    /// The same for songs that are no pieces of the reference; generated motions are named after
    /// them. With --beats, their beats are those of that file
    #[arg(long, value_name = "DIR", conflicts_with_all = ["music", "split"])]
    new_songs: Option<PathBuf>,
    /// Beats of the music: {"beats": {piece or audio file: [frame, ..]}}, frames at 60 a second
    #[arg(long, value_name = "F.json")]
    beats: Option<PathBuf>,
    /// Measure generated pieces of this split only; the row of the recordings is of the same split
    /// [default: all pieces, and recordings of the split test]
    #[arg(long)]
    split: Option<String>,
    /// Measure windows of this many frames instead of the first 1200 of each motion
    #[arg(long, value_name = "FRAMES")]
    window: Option<usize>,
    /// Frames from one window to the next [default: half a window]
    #[arg(long, value_name = "FRAMES", requires = "window")]
    stride: Option<usize>,
    /// Number of folders in --generated, one per seed: prints their mean with 95 % intervals
    #[arg(long, value_name = "N", value_parser = at_least_one::<NonZeroUsize>)]
    seeds: Option<NonZeroUsize>,
    /// Data folder whose training recordings teach what styles look like, so that the dances' own
    /// are recognised; repeated for several
    #[arg(long, value_name = "DIR")]
    styles_from: Vec<PathBuf>,
    /// The style that all generated dances were asked for [default: that of their piece]
    #[arg(long, value_name = "NAME", requires = "styles_from")]
    style: Option<String>,
    /// Acceleration in kinetic features: as published, or corrected (not comparable with published
    /// figures)
    #[arg(long, value_enum, default_value = "published")]
    kinetic: KineticArg,
    /// Measure whether bars that are alike in the music are alike in the dance, too. Songs are
    /// decoded for it: those of --music or --new-songs, else of the data folder
    #[arg(long)]
    form: bool,
    /// Seed of the random shifts and orders behind chance levels
    #[arg(long, default_value_t = 0)]
    chance_seed: u64,
    /// Print JSON instead of a Markdown table
    #[arg(long)]
    json: bool,
    /// Write a plot of generated relative to recorded too
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
                (beats, _, Some(folder)) => {
                    BeatsFrom::NewSongs { folder: folder.clone(), beats: beats.clone() }
                }
                (Some(file), ..) => BeatsFrom::File(file.clone()),
                (None, Some(folder), _) => BeatsFrom::Audio(folder.clone()),
                (None, None, None) => BeatsFrom::Reference,
            },
            clips: match self.window {
                None => Clips::default(),
                Some(length) => {
                    Clips::Windows { length, stride: self.stride.unwrap_or(length / 2) }
                }
            },
            kinetic: match self.kinetic {
                KineticArg::Published => KineticForm::Published,
                KineticArg::Corrected => KineticForm::Corrected,
            },
            seeds: self.seeds,
            styles_from: self.styles_from.clone(),
            style: self.style.clone(),
            form: self.form,
            chance_seed: self.chance_seed,
        }
    }
}

pub(super) fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    let report = evaluate(&args.options())?;
    if let Some(path) = &args.plot {
        write_file(path, report.svg()?)?;
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
