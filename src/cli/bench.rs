//! `bailando bench`: how fast the model and this machine are.

use std::{fs, num::NonZeroUsize, path::PathBuf};

use anyhow::{Context, anyhow};
use bailando::bench::{self, Baseline, BenchOptions};

use super::{say, say_error};

/// Measure how fast a model is on this machine: stages, steps, many dances at once, long songs
///
/// Nothing else should run meanwhile. benches/baseline/baseline.py measures librosa and PyTorch on the
/// same machine.
#[derive(Debug, clap::Args)]
pub(super) struct BenchArgs {
    /// The song, half a minute of it
    song: PathBuf,
    /// Model directory
    #[arg(long, env = "BAILANDO_MODEL_DIR", default_value = "models/default")]
    model_dir: PathBuf,
    /// Numbers of threads for steps; the last one's serve all else
    #[arg(long, value_delimiter = ',', default_value = "1,2")]
    threads: Vec<NonZeroUsize>,
    /// Repetitions of each stage, of which the median counts
    #[arg(long, default_value_t = 7)]
    repeats: usize,
    /// Lengths in seconds that the song is repeated to
    #[arg(long, value_delimiter = ',', default_value = "30,60,150,300,590", value_parser = super::positive_seconds)]
    lengths: Vec<f64>,
    /// Numbers of callers at the same time
    #[arg(long, value_delimiter = ',', default_value = "1,4,8")]
    callers: Vec<NonZeroUsize>,
    /// Codes of each of the eight dances that are generated at once
    #[arg(long, default_value_t = 225)]
    batch_codes: usize,
    /// Times of librosa and PyTorch, as benches/baseline/baseline.py writes them
    #[arg(long, value_name = "F.json")]
    baseline: Option<PathBuf>,
    /// Write all figures as JSON, too
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    /// Write a plot of time by length, too
    #[arg(long, value_name = "OUT.svg")]
    plot: Option<PathBuf>,
}

pub(super) fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let baseline = args
        .baseline
        .as_ref()
        .map(|path| -> anyhow::Result<Baseline> {
            let text = fs::read_to_string(path).with_context(|| format!("{}", path.display()))?;
            serde_json::from_str(&text).with_context(|| format!("{}", path.display()))
        })
        .transpose()?;
    let song = fs::read(&args.song).with_context(|| format!("{}", args.song.display()))?;
    let numbers = |numbers: &[NonZeroUsize]| numbers.iter().map(|number| number.get()).collect();
    let options = BenchOptions {
        model_dir: args.model_dir.clone(),
        song: song.into(),
        threads: numbers(&args.threads),
        repeats: args.repeats,
        lengths_s: args.lengths.clone(),
        callers: numbers(&args.callers),
        batch_codes: args.batch_codes.max(2),
    };
    let bench = bench::run(&options, &|what| say_error(&format!("measuring: {what}")))?;
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&bench)?;
        fs::write(path, text).with_context(|| format!("{}", path.display()))?;
    }
    if let Some(path) = &args.plot {
        let svg = bench
            .lengths_svg()
            .map_err(|problem| anyhow!("the plot: {problem}"))?;
        fs::write(path, svg).with_context(|| format!("{}", path.display()))?;
    }
    say(bench.markdown(baseline.as_ref()).trim_end());
    Ok(())
}
