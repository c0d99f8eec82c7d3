//! `bailando features`: a song's music features as a NumPy file.

use std::path::PathBuf;

use anyhow::Context;
use bailando::{
    CancelToken,
    audio::{self, AudioLimits, AudioRange},
    features::{BeatFinder, BeatPhase, FeatureExtractor, Profile, Rate, with_counts},
    model::{BeatNetwork, CountSource, ModelDirectory},
};
use clap::ValueEnum;

use super::console::{Usage, positive_seconds, read_file, say, say_error};

/// Write a song's music features as a NumPy file
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct FeaturesArgs {
    /// The song: wav, aiff, flac, mp3, ogg, webm or m4a. A wav already at the rate is not resampled
    audio: PathBuf,
    /// The file to write, .npy: float32 [rows, 438], and two more columns per count period
    #[arg(short, long, value_name = "OUT.npy")]
    output: PathBuf,
    /// Write the columns that this model was trained with, for `bailando generate --features`:
    /// profile and count periods are those of its manifest
    #[arg(long, value_name = "DIR", conflicts_with_all = ["rate", "profile", "count_periods"])]
    model_dir: Option<PathBuf>,
    /// Sample rate in Hz: 3840 gives 7.5 rows a second (one per pose code), 30720 gives 60
    #[arg(long, value_enum, default_value = "3840")]
    rate: RateArg,
    /// The librosa version whose numbers to reproduce
    #[arg(long, value_enum, default_value = "librosa-0.11")]
    profile: ProfileArg,
    /// Add the place within so many counts, as sine and cosine; 3840 Hz and librosa-0.11 only
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "N,..",
        value_parser = clap::value_parser!(u32).range(1..)
    )]
    count_periods: Vec<u32>,
    /// The tracker that counts are taken from: a model needs the one it was trained with
    #[arg(long, value_enum, default_value = "librosa", conflicts_with = "model_dir")]
    counts: CountsArg,
    /// Longest song in seconds
    #[arg(
        long,
        env = "BAILANDO_MAX_AUDIO_SECONDS",
        default_value_t = AudioLimits::default().max_seconds,
        value_parser = positive_seconds
    )]
    max_audio_seconds: f64,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RateArg {
    #[value(name = "3840")]
    Conditioning,
    #[value(name = "30720")]
    Beats,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ProfileArg {
    #[value(name = "librosa-0.11")]
    Librosa011,
    #[value(name = "librosa-0.8.1")]
    Librosa081,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum CountsArg {
    Librosa,
    Beatnet,
}

/// The columns to write.
struct Columns {
    rate: Rate,
    profile: Profile,
    count_periods: Vec<u32>,
    counts: CountSource,
    counts_late_s: f64,
}

impl FeaturesArgs {
    fn columns(&self) -> anyhow::Result<Columns> {
        if let Some(folder) = &self.model_dir {
            let directory = ModelDirectory::open(folder)?;
            let features = &directory.manifest().features;
            return Ok(Columns {
                rate: Rate::Conditioning,
                profile: features.profile,
                count_periods: features.count_periods.clone(),
                counts: features.counts,
                counts_late_s: features.counts_late_s,
            });
        }
        let rate = match self.rate {
            RateArg::Conditioning => Rate::Conditioning,
            RateArg::Beats => Rate::Beats,
        };
        let profile = match self.profile {
            ProfileArg::Librosa011 => Profile::Librosa011,
            ProfileArg::Librosa081 => Profile::Librosa081,
        };
        let fits = (rate, profile) == (Rate::Conditioning, Profile::Librosa011);
        if !self.count_periods.is_empty() && !fits {
            let problem = "--count-periods needs --rate 3840 and --profile librosa-0.11";
            return Err(Usage(problem.into()).into());
        }
        let counts = match self.counts {
            CountsArg::Librosa => CountSource::Librosa,
            CountsArg::Beatnet => CountSource::Beatnet,
        };
        let count_periods = self.count_periods.clone();
        Ok(Columns { rate, profile, count_periods, counts, counts_late_s: 0.0 })
    }
}

pub(super) fn run(args: &FeaturesArgs) -> anyhow::Result<()> {
    let is_npy = args.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy"));
    if !is_npy {
        let output = args.output.display();
        return Err(Usage(format!("{output}: features are written as NumPy files, .npy")).into());
    }
    let Columns { rate, profile, count_periods, counts, counts_late_s } = args.columns()?;
    let name = || args.audio.display().to_string();
    let song = read_file(&args.audio)?;
    // No shortest length here: the features have their own.
    let limits = AudioLimits {
        max_seconds: args.max_audio_seconds,
        min_seconds: 0.0,
        min_sample_rate: rate.hz().min(AudioLimits::default().min_sample_rate),
        ..AudioLimits::default()
    };
    let (range, cancel) = (AudioRange::default(), CancelToken::new());
    let mut rates = vec![rate.hz()];
    if !count_periods.is_empty() {
        rates.push(match counts {
            CountSource::Librosa => Rate::Beats.hz(),
            CountSource::Beatnet => BeatFinder::HZ,
        });
    }
    let decoded = audio::decode(song.into(), range, &rates, &limits, &cancel);
    let mut decoded = decoded.with_context(name)?;
    for warning in &decoded.warnings {
        say_error(&format!("warning: {}: {warning}", args.audio.display()));
    }
    let rows = FeatureExtractor::new(rate, profile).extract(&decoded.signals[0]);
    let mut rows = rows.with_context(name)?;
    if !count_periods.is_empty() {
        let signal = decoded.signals.swap_remove(1);
        let phase = match counts {
            CountSource::Librosa => {
                let beats =
                    FeatureExtractor::new(Rate::Beats, profile).beats_until(signal, &cancel);
                BeatPhase::find(&beats.with_context(name)?, rows.view())
            }
            CountSource::Beatnet => {
                let finder = &mut BeatFinder::new();
                let song = BeatNetwork::open()?.beats::<anyhow::Error>(finder, &signal, &cancel);
                BeatPhase::of(&song.with_context(name)?, rows.view())
            }
        };
        rows = with_counts(rows, phase.as_ref(), -counts_late_s, &count_periods);
    }
    let output = args.output.display();
    ndarray_npy::write_npy(&args.output, &rows).with_context(|| output.to_string())?;
    let (count, columns) = rows.dim();
    say(&format!("{output}: {count} rows of {columns} columns"));
    Ok(())
}
