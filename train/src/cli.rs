//! The command line: parse, call, print.

use std::{
    collections::BTreeMap,
    io::{self, Write},
    path::{Path, PathBuf},
};

use bailando::{features::Profile, model::Manifest, model::WeightStorage, motion::MotionFrame};
use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::{
    data::{
        OpenOptions,
        check::{CheckOptions, check},
    },
    export::Description,
    import::{ImportOptions, import},
    training::{Config, Limits, MotionSet, Outcome, Stage, export, run_all, train},
};

/// What is said of a run that a limit ended.
const PAUSED: &str = "paused: the same command goes on";

/// Offline companion of bailando: makes the model directories that the server runs.
#[derive(Debug, Parser)]
#[command(name = "bailando-train", version, max_term_width = 100)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Import(Box<ImportArguments>),
    /// Train everything that is not finished yet, stage by stage, and write the model directory
    Run(WholeArguments),
    /// Train both halves of the pose VQ-VAE
    #[command(name = "vqvae")]
    VqVae(StageArguments),
    /// Train the root's velocity on the finished VQ-VAE
    Velocity(StageArguments),
    /// Train the motion GPT on the finished VQ-VAE's codes
    Gpt(StageArguments),
    /// Write the model directory of a finished run
    Export(RunArguments),
    CheckData(CheckArguments),
}

#[derive(Args, Debug)]
struct RunArguments {
    /// Settings; what the file does not say is as published
    config: PathBuf,

    /// Replace the model that is already there
    #[arg(long)]
    force: bool,
}

/// Every stage goes on from its last checkpoint; a kill loses at most `run.checkpoint_seconds`.
#[derive(Args, Debug)]
struct WholeArguments {
    #[command(flatten)]
    run: RunArguments,

    /// Write a checkpoint and stop after this many seconds, all stages together; the same command
    /// goes on
    #[arg(long, value_name = "S")]
    max_seconds: Option<f64>,
}

/// A stage goes on from its last checkpoint; a kill loses at most `run.checkpoint_seconds`.
#[derive(Args, Debug)]
struct StageArguments {
    /// Settings; what the file does not say is as published
    config: PathBuf,

    /// Official checkpoint to start from (vqvae and gpt)
    #[arg(long, value_name = "FILE.pt")]
    init: Option<PathBuf>,

    /// Folder of music features (gpt) [default: `data.cache` of the settings]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,

    /// Write a checkpoint and stop after this many seconds; the same command goes on
    #[arg(long, value_name = "S")]
    max_seconds: Option<f64>,

    /// Write a checkpoint and stop after this many steps; the same command goes on
    #[arg(long, value_name = "N")]
    max_steps: Option<u64>,
}

/// Turn official PyTorch checkpoints into a model directory.
///
/// Reads the two checkpoints of a trained model without executing anything in them, writes the
/// ONNX graphs and the manifest, and loads the result once to check it. The defaults are those of
/// the officially published weights.
#[derive(Args, Debug)]
#[command(
    after_help = "Example: bailando-train import --vqvae vqvae.pt --gpt gpt.pt --out models/mine"
)]
struct ImportArguments {
    /// Checkpoint of the pose VQ-VAE with the root's velocity branch
    #[arg(long, value_name = "FILE.pt")]
    vqvae: PathBuf,

    /// Checkpoint of the motion GPT
    #[arg(long, value_name = "FILE.pt")]
    gpt: PathBuf,

    /// Model directory to write
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Attention heads of the GPT: the one size that the checkpoint does not tell
    #[arg(long, default_value_t = 12, value_name = "N")]
    heads: usize,

    /// Version of the music features that the GPT was trained with
    #[arg(long, value_enum, default_value_t = ProfileName::Librosa081)]
    profile: ProfileName,

    /// JSON list of [upper, lower] code pairs to start from, or an object with it as `start_codes`
    /// [default: the pair 423, 12 where the vocabulary has it, else any pair]
    #[arg(long, value_name = "FILE.json")]
    start_codes: Option<PathBuf>,

    /// Default sampling temperature; 0 always takes the most likely code
    #[arg(long, default_value_t = 0.0, value_name = "T", value_parser = temperature)]
    temperature: f32,

    /// How weights are stored: f32 exactly, f16 in half the space (they are computed with in f32)
    #[arg(long, value_enum, default_value_t = Weights::F32)]
    weights: Weights,

    /// Name of the model, reported with every dance
    #[arg(long, default_value = "bailando-official")]
    name: String,

    /// Licence of the weights, as their owner gives it
    #[arg(
        long,
        default_value = "non-commercial, as given by the authors of the published weights"
    )]
    licence: String,

    /// Height in metres at which the pelvis starts above the floor
    #[arg(long, default_value_t = 0.93, value_name = "METRES", value_parser = root_height)]
    root_height: f32,

    /// JSON object that says how the model was trained; copied into the manifest
    #[arg(long, value_name = "FILE.json")]
    training: Option<PathBuf>,

    /// Replace the model that is already in DIR
    #[arg(long)]
    force: bool,
}

/// Say what is wrong with a folder of training data, before hours are spent on it.
///
/// Reads every motion and every song and reports in plain words: missing files, lengths, units
/// (metres), axes (y up), bone lengths, frame rate (60 a second), jumps, left and right, the floor,
/// silence, beats, and whether anything of the test split is in the training split. Three layouts
/// are understood: a folder with index.json, the reference's JSON files, and AIST++ .pkl motions.
///
/// Exit code 0: training can start (there may be warnings); 1: something makes the data unusable.
#[derive(Args, Debug)]
#[command(after_help = "Examples:
  bailando-train check-data data/salsa
  bailando-train check-data aist_plusplus_final --audio all_musics
  bailando-train check-data data/mine --json > report.json")]
struct CheckArguments {
    /// Folder of training data
    #[arg(value_name = "DIR")]
    folder: PathBuf,

    /// Folder of the songs, where they are kept apart from the motions
    #[arg(long, value_name = "DIR")]
    audio: Option<PathBuf>,

    /// Decode only N songs, spread evenly [default: all]
    #[arg(long, value_name = "N")]
    songs: Option<usize>,

    /// Find the beats of N songs and compare them with the data's own
    #[arg(long, default_value_t = CheckOptions::default().beats, value_name = "N")]
    beats: usize,

    /// Print the whole report as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ProfileName {
    #[value(name = "librosa-0.11")]
    Librosa011,
    #[value(name = "librosa-0.8.1")]
    Librosa081,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Weights {
    F16,
    F32,
}

fn temperature(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err("expected a number of 0 or more".into()),
    }
}

fn root_height(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value > 0.0 && value <= 10.0 => Ok(value),
        _ => Err("expected a height in metres, above 0 and at most 10".into()),
    }
}

/// Runs one command and reports on `output`.
///
/// # Errors
/// Whatever the command or the output gives, for one line on standard error.
pub fn run(arguments: Arguments, output: &mut impl Write) -> anyhow::Result<()> {
    match arguments.command {
        Command::Import(arguments) => {
            let options = ImportOptions::from(*arguments);
            let manifest = import(&options)?;
            report(&options, &manifest, output)?;
            Ok(())
        }
        Command::Run(arguments) => train_all(&arguments, output),
        Command::VqVae(arguments) => train_stage(Stage::VqVae, &arguments, output),
        Command::Velocity(arguments) => train_stage(Stage::Velocity, &arguments, output),
        Command::Gpt(arguments) => train_stage(Stage::Gpt, &arguments, output),
        Command::Export(arguments) => {
            let config = Config::read(&arguments.config)?;
            let manifest = export(&config, arguments.force)?;
            let folder = config.export.folder.display();
            writeln!(output, "wrote {folder} ({})", manifest.name)?;
            Ok(())
        }
        Command::CheckData(arguments) => check_data(arguments, output),
    }
}

fn train_stage(
    stage: Stage,
    arguments: &StageArguments,
    output: &mut impl Write,
) -> anyhow::Result<()> {
    let mut config = Config::read(&arguments.config)?;
    if let Some(cache) = &arguments.cache {
        config.data.cache.clone_from(cache);
    }
    anyhow::ensure!(
        arguments.init.is_none() || stage != Stage::Velocity,
        "velocity has no --init: it starts from the VQ-VAE of the run"
    );
    let set = MotionSet::read(&config.data, stage.load(), output)?;
    let limits = Limits {
        seconds: arguments.max_seconds,
        steps: arguments.max_steps,
    };
    let init = arguments.init.as_deref();
    match train(stage, &config, &set, init, limits, output)? {
        Outcome::Finished => writeln!(output, "finished")?,
        Outcome::Paused => writeln!(output, "{PAUSED}")?,
    }
    Ok(())
}

fn train_all(arguments: &WholeArguments, output: &mut impl Write) -> anyhow::Result<()> {
    let config = Config::read(&arguments.run.config)?;
    match run_all(&config, arguments.run.force, arguments.max_seconds, output)? {
        Outcome::Finished => try_it(&config.export.folder, output)?,
        Outcome::Paused => writeln!(output, "{PAUSED}")?,
    }
    Ok(())
}

fn try_it(model: &Path, output: &mut impl Write) -> io::Result<()> {
    let model = model.display();
    writeln!(output, "try it: bailando serve --model-dir {model}")
}

fn check_data(arguments: CheckArguments, output: &mut impl Write) -> anyhow::Result<()> {
    let options = CheckOptions {
        open: OpenOptions {
            audio: arguments.audio,
        },
        songs: arguments.songs,
        beats: arguments.beats,
    };
    let report = check(&arguments.folder, &options)?;
    if arguments.json {
        serde_json::to_writer_pretty(&mut *output, &report)?;
        writeln!(output)?;
    } else {
        write!(output, "{report}")?;
    }
    if report.is_usable() {
        return Ok(());
    }
    anyhow::bail!("{}: {}", arguments.folder.display(), report.verdict())
}

impl From<ImportArguments> for ImportOptions {
    fn from(arguments: ImportArguments) -> Self {
        Self {
            vqvae: arguments.vqvae,
            gpt: arguments.gpt,
            out: arguments.out,
            replace: arguments.force,
            heads: arguments.heads,
            start_codes: arguments.start_codes,
            training: arguments.training,
            description: Description {
                name: arguments.name,
                licence: arguments.licence,
                profile: match arguments.profile {
                    ProfileName::Librosa011 => Profile::Librosa011,
                    ProfileName::Librosa081 => Profile::Librosa081,
                },
                start_codes: Vec::new(),
                temperature: arguments.temperature,
                motion_frame: MotionFrame::World,
                root_height: arguments.root_height,
                weights: match arguments.weights {
                    Weights::F16 => WeightStorage::F16,
                    Weights::F32 => WeightStorage::F32,
                },
                training: BTreeMap::new(),
            },
        }
    }
}

fn report(options: &ImportOptions, manifest: &Manifest, output: &mut impl Write) -> io::Result<()> {
    let gpt = manifest.gpt;
    writeln!(
        output,
        "wrote {} ({})",
        options.out.display(),
        manifest.name
    )?;
    writeln!(
        output,
        "  {} upper and {} lower codes; GPT of {} layers, {} channels, {} heads; decoder of width {}",
        manifest.vocabulary.upper,
        manifest.vocabulary.lower,
        gpt.layers,
        gpt.channels,
        gpt.heads,
        manifest.decoder.width,
    )?;
    for (name, file) in &manifest.files {
        writeln!(output, "  {name:<13} {:>8.1} MB", file.bytes as f64 / 1e6)?;
    }
    try_it(&options.out, output)
}
