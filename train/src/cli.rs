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
        OpenOptions, Split,
        check::{CheckOptions, check},
    },
    encode::{EncodeOptions, encode},
    export::Description,
    import::{ImportOptions, import},
    training::{
        AblationConfig, Adaptation, Config, Limits, MotionSet, Outcome, Stage, adapt, export,
        export_adapted, generate_test_dances, run_all, target_song, train,
    },
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
    /// Train the policy on rewards of the dances it generates, beside a critic
    ActorCritic(StageArguments),
    Adapt(AdaptArguments),
    /// Write the model directory of a finished run
    Export(RunArguments),
    Encode(EncodeArguments),
    Generate(GenerateArguments),
    CheckData(CheckArguments),
}

/// Send recordings through a model's pose VQ-VAE: their codes, and what the decoder makes of them
///
/// Writes `<id>.codes.npy` (int64 [2, codes], upper and lower) of every recording, and with
/// --reconstruct `<id>.npy` (float32 [frames, 24, 3]), which `bailando evaluate` measures.
#[derive(Args, Debug)]
struct EncodeArguments {
    /// Data folder of any layout
    #[arg(value_name = "DIR")]
    data: PathBuf,

    /// Model directory
    #[arg(long, default_value = "models/default", value_name = "DIR")]
    model_dir: PathBuf,

    /// Folder to write to
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Which recordings
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    split: SplitName,

    /// Decode the codes again, too
    #[arg(long)]
    reconstruct: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum SplitName {
    Train,
    Test,
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

    /// Official checkpoint to start from (vqvae, gpt; of actor-critic and adapt: the critic)
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

/// Generate dances of a finished run for all songs of the test split.
///
/// One DIR/<piece>.npy each ([frames, 24, 3] at 60 a second), for `bailando evaluate --generated
/// DIR`. Runs with parts left out ([ablation]) have no other way: the server knows whole models.
#[derive(Args, Debug)]
struct GenerateArguments {
    /// Settings of the run
    config: PathBuf,

    /// Folder to write
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// The same seed gives the same dances
    #[arg(long, default_value_t = 1, value_name = "N")]
    seed: u64,

    /// Folder of music features [default: `data.cache` of the settings]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

/// Train the policy on the rewards of one song, for which no dance is needed.
///
/// Starts from the finished actor-critic of the run, else from its gpt. Goes on from its last
/// checkpoint, which is found by the song's content.
#[derive(Args, Debug)]
#[command(after_help = "Example: bailando-train adapt train/presets/default.toml --song song.mp3")]
struct AdaptArguments {
    #[command(flatten)]
    stage: StageArguments,

    /// The song: any audio file that the server takes
    #[arg(long, value_name = "FILE")]
    song: PathBuf,

    /// Model directory to write [default: `model` in the song's folder of the run]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Replace the model that is already there
    #[arg(long)]
    force: bool,
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
        Command::ActorCritic(arguments) => train_stage(Stage::ActorCritic, &arguments, output),
        Command::Adapt(arguments) => adapt_policy(&arguments, output),
        Command::Export(arguments) => {
            let config = Config::read(&arguments.config)?;
            let manifest = export(&config, arguments.force)?;
            let folder = config.export.folder.display();
            writeln!(output, "wrote {folder} ({})", manifest.name)?;
            Ok(())
        }
        Command::Encode(arguments) => {
            let out = arguments.out.clone();
            let count = encode(&arguments.into())?;
            writeln!(output, "wrote {count} recordings to {}", out.display())?;
            Ok(())
        }
        Command::Generate(arguments) => generate(&arguments, output),
        Command::CheckData(arguments) => check_data(arguments, output),
    }
}

fn train_stage(
    stage: Stage,
    arguments: &StageArguments,
    output: &mut impl Write,
) -> anyhow::Result<()> {
    let config = arguments.config()?;
    anyhow::ensure!(
        arguments.init.is_none() || stage != Stage::Velocity,
        "velocity has no --init: it starts from the VQ-VAE of the run"
    );
    let set = MotionSet::read(&config.data, stage.load(), output)?;
    let (init, limits) = (arguments.init.as_deref(), arguments.limits());
    let outcome = train(stage, &config, &set, init, limits, output)?;
    report_outcome(outcome, output)
}

fn adapt_policy(arguments: &AdaptArguments, output: &mut impl Write) -> anyhow::Result<()> {
    let config = arguments.stage.config()?;
    let song = target_song(&config.data, &arguments.song)?;
    let adaptation = Adaptation::new(&config, &arguments.song, song)?;
    let (init, limits) = (arguments.stage.init.as_deref(), arguments.stage.limits());
    let outcome = adapt(&config, &adaptation, init, limits, output)?;
    report_outcome(outcome, output)?;
    if outcome == Outcome::Paused {
        return Ok(());
    }
    let folder = arguments.out.clone();
    let folder = folder.unwrap_or_else(|| adaptation.folder.join("model"));
    let manifest = export_adapted(&config, &adaptation, &folder, arguments.force)?;
    writeln!(output, "wrote {} ({})", folder.display(), manifest.name)?;
    Ok(())
}

fn generate(arguments: &GenerateArguments, output: &mut impl Write) -> anyhow::Result<()> {
    let config = with_cache(&arguments.config, arguments.cache.as_deref())?;
    let (seed, folder) = (arguments.seed, &arguments.out);
    let count = generate_test_dances(&config, seed, folder, output)?;
    writeln!(output, "wrote {count} dances to {}", folder.display())?;
    Ok(())
}

fn report_outcome(outcome: Outcome, output: &mut impl Write) -> anyhow::Result<()> {
    match outcome {
        Outcome::Finished => writeln!(output, "finished")?,
        Outcome::Paused => writeln!(output, "{PAUSED}")?,
    }
    Ok(())
}

fn train_all(arguments: &WholeArguments, output: &mut impl Write) -> anyhow::Result<()> {
    let config = Config::read(&arguments.run.config)?;
    match run_all(&config, arguments.run.force, arguments.max_seconds, output)? {
        Outcome::Finished if config.ablation == AblationConfig::default() => {
            try_it(&config.export.folder, output)?;
        }
        Outcome::Finished => {}
        Outcome::Paused => writeln!(output, "{PAUSED}")?,
    }
    Ok(())
}

fn try_it(model: &Path, output: &mut impl Write) -> io::Result<()> {
    let model = model.display();
    writeln!(output, "try it: bailando serve --model-dir {model}")
}

/// The settings, with another folder of music features.
fn with_cache(config: &Path, cache: Option<&Path>) -> anyhow::Result<Config> {
    let mut config = Config::read(config)?;
    if let Some(cache) = cache {
        config.data.cache = cache.to_owned();
    }
    Ok(config)
}

impl StageArguments {
    /// The settings, with what the command line changes.
    fn config(&self) -> anyhow::Result<Config> {
        with_cache(&self.config, self.cache.as_deref())
    }

    fn limits(&self) -> Limits {
        Limits {
            seconds: self.max_seconds,
            steps: self.max_steps,
        }
    }
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

impl From<EncodeArguments> for EncodeOptions {
    fn from(arguments: EncodeArguments) -> Self {
        Self {
            model: arguments.model_dir,
            data: arguments.data,
            split: match arguments.split {
                SplitName::Train => Split::Train,
                SplitName::Test => Split::Test,
            },
            out: arguments.out,
            reconstruct: arguments.reconstruct,
        }
    }
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
