//! `bailando bench`: the speed of a model on this machine.

use std::{num::NonZeroUsize, path::PathBuf};

use anyhow::{Context, anyhow};
use bailando::{
    bench::{self, Baseline, BenchOptions},
    model::Device,
};

use super::console::{at_least_one, positive_seconds, read_file, say, say_error, write_file};

/// Measure the speed of a model on this machine: stages, steps, many dances at once, long songs
///
/// Nothing else should run meanwhile. benches/baseline/baseline.py measures librosa and PyTorch on
/// the same machine.
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct BenchArgs {
    /// A song of about half a minute
    song: PathBuf,
    /// Model directory
    #[arg(long, env = "BAILANDO_MODEL_DIR", default_value = "models/default")]
    model_dir: PathBuf,
    /// What computes the model: cpu, cuda or cuda:N
    #[arg(long, env = "BAILANDO_DEVICE", default_value_t = Device::Cpu)]
    device: Device,
    /// Numbers of threads for steps; everything else uses the last one
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "1,2",
        value_parser = at_least_one::<NonZeroUsize>
    )]
    threads: Vec<NonZeroUsize>,
    /// Repetitions of each stage, of which the median counts
    #[arg(long, default_value_t = 7)]
    repeats: usize,
    /// Lengths in seconds that the song is repeated to
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "30,60,150,300,590",
        value_parser = positive_seconds
    )]
    lengths: Vec<f64>,
    /// Numbers of callers at the same time
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "1,4,8",
        value_parser = at_least_one::<NonZeroUsize>
    )]
    callers: Vec<NonZeroUsize>,
    /// Pose codes of each of the eight dances that are generated at once
    #[arg(long, default_value_t = 225)]
    batch_codes: usize,
    /// Times of librosa and PyTorch, as benches/baseline/baseline.py writes them
    #[arg(long, value_name = "F.json")]
    baseline: Option<PathBuf>,
    /// Write all figures as JSON too
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    /// Write a plot of time by length too
    #[arg(long, value_name = "OUT.svg")]
    plot: Option<PathBuf>,
}

pub(super) fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let baseline = match &args.baseline {
        None => Baseline::default(),
        Some(path) => {
            serde_json::from_slice(&read_file(path)?).with_context(|| path.display().to_string())?
        }
    };
    let numbers = |numbers: &[NonZeroUsize]| numbers.iter().map(|number| number.get()).collect();
    let options = BenchOptions {
        model_dir: args.model_dir.clone(),
        device: args.device,
        song: read_file(&args.song)?.into(),
        threads: numbers(&args.threads),
        repeats: args.repeats,
        lengths_s: args.lengths.clone(),
        callers: numbers(&args.callers),
        batch_codes: args.batch_codes.max(2),
    };
    let bench = bench::run(&options, &|part| say_error(&format!("measuring: {part}")))?;
    if let Some(path) = &args.json {
        write_file(path, serde_json::to_string_pretty(&bench)?)?;
    }
    if let Some(path) = &args.plot {
        let svg = bench.lengths_svg();
        write_file(path, svg.map_err(|problem| anyhow!("the plot: {problem}"))?)?;
    }
    say(bench.markdown(&baseline).trim_end());
    Ok(())
}
