//! `bailando features`: a song's music features as a NumPy file.

use std::{fs, path::PathBuf};

use anyhow::Context;
use bailando::{
    CancelToken,
    audio::{self, AudioLimits, AudioRange},
    features::{FeatureExtractor, Profile, Rate, with_counts_of},
};
use clap::ValueEnum;

use super::Usage;

/// Write a song's music features as a NumPy file
#[derive(Debug, clap::Args)]
pub(super) struct FeaturesArgs {
    /// The song: wav, flac, mp3, ogg/vorbis or m4a/aac. A wav already at the rate is not resampled
    audio: PathBuf,
    /// The file to write: float32 [rows, 438], wider by two columns a count period
    #[arg(short, long, value_name = "OUT.npy")]
    output: PathBuf,
    /// Sample rate in Hz: 3840 gives 7.5 rows a second (one per pose code), 30720 gives 60
    #[arg(long, value_enum, default_value = "3840")]
    rate: RateArg,
    /// Which librosa version's numbers
    #[arg(long, value_enum, default_value = "librosa-0.11")]
    profile: ProfileArg,
    /// Add the place within so many counts (sine and cosine each): a model's manifest says which it
    /// hears as `count_periods`. At 3840 Hz, with librosa-0.11
    #[arg(long, value_delimiter = ',', value_name = "N,..", value_parser = clap::value_parser!(u32).range(1..))]
    count_periods: Vec<u32>,
    /// Longest song in seconds
    #[arg(
        long,
        env = "BAILANDO_MAX_AUDIO_SECONDS",
        default_value_t = AudioLimits::default().max_seconds,
        value_parser = super::positive_seconds
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

pub(super) fn run(args: &FeaturesArgs) -> anyhow::Result<()> {
    let rate = match args.rate {
        RateArg::Conditioning => Rate::Conditioning,
        RateArg::Beats => Rate::Beats,
    };
    let profile = match args.profile {
        ProfileArg::Librosa011 => Profile::Librosa011,
        ProfileArg::Librosa081 => Profile::Librosa081,
    };
    let counts = !args.count_periods.is_empty();
    if counts && (rate, profile) != (Rate::Conditioning, Profile::Librosa011) {
        return Err(Usage(
            "--count-periods goes with --rate 3840 and --profile librosa-0.11".into(),
        )
        .into());
    }
    let name = || args.audio.display().to_string();
    let bytes = fs::read(&args.audio).with_context(name)?;
    // No shortest length here: the features themselves say when a signal is too short.
    let limits = AudioLimits {
        max_seconds: args.max_audio_seconds,
        min_seconds: 0.0,
        min_sample_rate: rate.hz().min(AudioLimits::default().min_sample_rate),
        ..AudioLimits::default()
    };
    let cancel = CancelToken::new();
    let rates = [rate.hz(), Rate::Beats.hz()];
    let decoded = audio::decode(
        bytes.into(),
        AudioRange::default(),
        if counts { &rates[..] } else { &rates[..1] },
        &limits,
        &cancel,
    )
    .with_context(name)?;
    for warning in &decoded.warnings {
        super::say_error(&format!("warning: {}: {warning}", args.audio.display()));
    }
    let mut signals = decoded.signals.into_iter();
    let signal = signals.next().unwrap_or_default();
    let mut rows = FeatureExtractor::new(rate, profile)
        .extract(&signal)
        .with_context(name)?;
    drop(signal);
    if counts {
        let signal = signals.next().unwrap_or_default();
        let beats = FeatureExtractor::new(Rate::Beats, profile).beats_until(signal, &cancel);
        rows = with_counts_of(&beats.with_context(name)?, rows, &args.count_periods);
    }
    ndarray_npy::write_npy(&args.output, &rows)
        .with_context(|| args.output.display().to_string())?;
    super::say(&format!(
        "{}: {} rows of {} columns",
        args.output.display(),
        rows.nrows(),
        rows.ncols()
    ));
    Ok(())
}
