//! Arguments of the command line, and the options that they become.

use std::{collections::BTreeMap, path::PathBuf};

use bailando::{
    features::Profile,
    model::{CountSource, SuppressedCodes, WeightStorage},
    motion::MotionFrame,
};
use clap::{
    Args, Parser, Subcommand,
    builder::{PossibleValuesParser, TypedValueParser},
};
use serde::de::DeserializeOwned;

use crate::{
    compare::CompareOptions,
    data::{check::CheckOptions, convert::ConvertOptions},
    encode::EncodeOptions,
    export::{Description, PUBLISHED_HOP},
    import::ImportOptions,
    music_gap::MusicGapOptions,
    training::{Config, Limits, StopFlag},
};

/// Offline companion of bailando: makes the model directories that the server runs.
#[derive(Debug, Parser)]
#[command(name = "bailando-train", version, max_term_width = 100)]
pub struct Arguments {
    #[command(subcommand)]
    pub(super) command: Command,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    Import(Box<ImportArguments>),
    /// Train every stage that is not finished yet, and write the model directory
    Run(WholeArguments),
    /// Train both halves of the pose VQ-VAE
    #[command(name = "vqvae")]
    VqVae(StageArguments),
    /// Train the root's velocity on the finished VQ-VAE
    Velocity(StageArguments),
    /// Train the motion GPT on the finished VQ-VAE's codes
    Gpt(StageArguments),
    /// Train the policy on rewards of the motion that it generates, beside a critic
    ActorCritic(StageArguments),
    Adapt(AdaptArguments),
    /// Write the model directory of a finished run
    Export(RunArguments),
    /// Encode recordings with a model's pose VQ-VAE, and decode them again
    ///
    /// Writes `<id>.codes.npy` (int64 [2, codes], upper and lower) of every recording, and with
    /// --reconstruct `<id>.npy` (float32 [frames, 24, 3]), which `bailando evaluate` measures.
    Encode(DataCommand<EncodeOptions>),
    Generate(GenerateArguments),
    /// Measure how much a model is conditioned on the music: how much worse it predicts recordings
    /// with other music
    ///
    /// Cross-entropy of a recording's codes with its own song, and the increase with the song of
    /// another recording, and with its own song one beat and half a bar early. Gaps of 0 mean that
    /// the model ignores the music.
    MusicGap(ReportCommand<MusicGapOptions>),
    /// Compare a quantised model with its original: equal codes and perplexity on recordings
    ///
    /// Both predict the codes of the same recordings. scripts/compare-models.sh also compares
    /// generated motion.
    Compare(ReportCommand<CompareOptions>),
    /// Learn to tell the style of a song, and print what the test songs are taken for
    ///
    /// Learns from the training songs of the data folders and writes `styles.json` into the run's
    /// folder; `export` adds it to the model directory, which then answers `style=auto`. `run` does
    /// the same where it is missing.
    Styles(StylesArguments),
    /// Turn motion capture (BVH, AMASS .npz, SMPL .pkl) into a data folder
    ///
    /// Every motion is put on the skeleton of the models, turned upright, brought to 60 frames a
    /// second and stood on the floor. BVH may have the joints of SMPL, Mixamo, VRM, Unreal or of
    /// classic BVH files. A file that cannot be converted is named and left out (exit code 1).
    Convert(ConvertOptions),
    /// Check a folder of training data before hours are spent on it.
    ///
    /// Reads every motion and every song and reports in plain words: missing files, lengths, units
    /// (metres), axes (y up), bone lengths, frame rate (60 a second), jumps, left and right, the
    /// floor, silence, beats, and whether anything of the test split is in the training split.
    /// Three layouts are understood: a folder with index.json, the reference's JSON files, and
    /// AIST++ .pkl motions.
    ///
    /// Exit code 0: training can start (there may be warnings); 1: something makes the data
    /// unusable.
    #[command(after_help = "Examples:
  bailando-train check-data data/salsa
  bailando-train check-data aist_plusplus_final --audio all_musics
  bailando-train check-data data/mine --json > report.json")]
    CheckData(ReportCommand<CheckOptions>),
}

/// A data folder, by its place or by its name.
#[derive(Args, Debug)]
struct DataArguments {
    /// Data folder of any layout
    #[arg(value_name = "DIR", required_unless_present = "data")]
    folder: Option<PathBuf>,

    /// The same by name, as the training commands take it
    #[arg(long, value_name = "DIR", conflicts_with = "folder")]
    data: Option<PathBuf>,
}

/// A command on a data folder.
#[derive(Args, Debug)]
pub(super) struct DataCommand<O: Args> {
    #[command(flatten)]
    options: O,

    #[command(flatten)]
    data: DataArguments,
}

impl<O: Args> DataCommand<O> {
    /// Returns the folder and the options.
    #[expect(clippy::expect_used, reason = "clap requires one of them")]
    pub(super) fn split(self) -> (PathBuf, O) {
        let DataArguments { folder, data } = self.data;
        (folder.or(data).expect("a data folder"), self.options)
    }
}

/// A command that reports on a data folder.
#[derive(Args, Debug)]
pub(super) struct ReportCommand<O: Args> {
    #[command(flatten)]
    pub(super) command: DataCommand<O>,

    /// Print JSON
    #[arg(long)]
    pub(super) json: bool,
}

/// The settings of a run, and folders that the command line replaces.
#[derive(Args, Debug)]
pub(super) struct SettingsArguments {
    /// Settings (TOML); settings that the file leaves out are as published
    config: PathBuf,

    /// Folder of training data, of any layout; may be repeated [default: those of the settings]
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,

    /// Folder of music features [default: `data.cache` of the settings]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

#[derive(Args, Debug)]
pub(super) struct StylesArguments {
    #[command(flatten)]
    pub(super) settings: SettingsArguments,

    /// Print JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args, Debug)]
pub(super) struct RunArguments {
    #[command(flatten)]
    pub(super) settings: SettingsArguments,

    /// Replace the model that is already there
    #[arg(long)]
    pub(super) force: bool,
}

/// Every stage resumes from its last checkpoint. Ctrl-C writes one and stops; a kill loses at most
/// `run.checkpoint_seconds`. More steps in the settings lengthen a finished stage.
#[derive(Args, Debug)]
pub(super) struct WholeArguments {
    #[command(flatten)]
    pub(super) run: RunArguments,

    /// Model directory that all stages but actor-critic start from; codes and styles that it has
    /// not are added
    #[arg(long, value_name = "DIR")]
    pub(super) init: Option<PathBuf>,

    /// Write a checkpoint and stop after this many seconds, all stages together; the same command
    /// resumes
    #[arg(long, value_name = "S")]
    pub(super) max_seconds: Option<f64>,
}

/// A stage resumes from its last checkpoint. Ctrl-C writes one and stops; a kill loses at most
/// `run.checkpoint_seconds`. More steps in the settings lengthen a finished stage.
#[derive(Args, Debug)]
pub(super) struct StageArguments {
    #[command(flatten)]
    pub(super) settings: SettingsArguments,

    /// What to start from: a model directory (vqvae, velocity, gpt) or an official checkpoint
    /// (vqvae, gpt; actor-critic takes its critic, adapt where it learns from rewards). gpt also
    /// takes a run's checkpoint.safetensors
    #[arg(long, value_name = "DIR|FILE.pt")]
    pub(super) init: Option<PathBuf>,

    /// Write a checkpoint and stop after this many seconds; the same command resumes
    #[arg(long, value_name = "S")]
    pub(super) max_seconds: Option<f64>,

    /// Write a checkpoint and stop after this many steps; the same command resumes
    #[arg(long, value_name = "N")]
    pub(super) max_steps: Option<u64>,
}

/// Generate motion with a finished run for all songs of the test split.
///
/// One DIR/<piece>.npy each ([frames, 24, 3] at 60 a second), for `bailando evaluate --generated
/// DIR`. This is the only way for runs with parts left out ([ablation]): the server takes whole
/// models.
#[derive(Args, Debug)]
pub(super) struct GenerateArguments {
    #[command(flatten)]
    pub(super) settings: SettingsArguments,

    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,

    /// The same seed gives the same motions
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub(super) seed: u64,
}

/// Adapt a model to a song or several, for which no motion is needed
///
/// By the settings it imitates its own dances to the songs, the best of some candidates for each
/// phrase, or learns from their rewards. Starts from a model directory, else from the finished
/// actor-critic of the run, else from its gpt. Resumes from its last checkpoint, which is found by
/// the content of songs and model.
#[derive(Args, Debug)]
#[command(after_help = "Example: bailando-train adapt train/presets/default.toml \\
  --model models/default --song song.mp3 --out models/song")]
pub(super) struct AdaptArguments {
    #[command(flatten)]
    pub(super) stage: StageArguments,

    /// The song: any audio file that the server takes. Given several times, the model is adapted to
    /// all of them
    #[arg(long = "song", value_name = "FILE", required = true)]
    pub(super) songs: Vec<PathBuf>,

    /// Model directory to start from: what the settings say of sizes, features and counts is the
    /// model's then [default: the run of the settings]
    #[arg(long, value_name = "DIR")]
    pub(super) model: Option<PathBuf>,

    /// Model directory to write [default: `model` in the song's folder of the run]
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,

    /// Replace the model that is already there
    #[arg(long)]
    pub(super) force: bool,
}

/// Turn official PyTorch checkpoints into a model directory.
///
/// Reads the two checkpoints of a trained model without executing anything in them, writes the
/// ONNX graphs and the manifest, and tries the result on eight seconds of a plain beat. What
/// torch.save writes (a state dictionary, or one under `model`) and safetensors are read, in
/// float32, half, bfloat16 or float64, with or without the prefixes `module.` and `_orig_mod.`. The
/// defaults are those of the officially published weights.
#[derive(Args, Debug)]
#[command(
    after_help = "Example: bailando-train import --vqvae vqvae.pt --gpt gpt.pt --out models/mine"
)]
pub(super) struct ImportArguments {
    /// Checkpoint of the pose VQ-VAE with the root's velocity branch
    #[arg(long, value_name = "FILE")]
    pub(super) vqvae: PathBuf,

    /// Checkpoint of the motion GPT
    #[arg(long, value_name = "FILE")]
    pub(super) gpt: PathBuf,

    /// Model directory to write
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,

    /// Attention heads of the GPT: the only size that the checkpoint does not hold
    #[arg(long, default_value_t = 12, value_name = "N")]
    pub(super) heads: usize,

    /// Version of the music features that the GPT was trained with
    #[arg(long, default_value = "librosa-0.8.1", value_parser = named::<Profile>(&PROFILES))]
    pub(super) profile: Profile,

    /// JSON list of [upper, lower] code pairs to start from, or an object with it as `start_codes`
    /// [default: the pair 423, 12 where the vocabulary has it, else any pair]
    #[arg(long, value_name = "FILE.json")]
    pub(super) start_codes: Option<PathBuf>,

    /// Default sampling temperature; 0 always takes the most likely code
    #[arg(long, default_value_t = 0.0, value_name = "T", value_parser = temperature)]
    pub(super) temperature: f32,

    /// How weights are stored: f32 exactly, f16 in half the space (computed with in f32), int8 with
    /// the GPT's matrices in a quarter of it (and products of 8-bit numbers)
    #[arg(long, default_value = "f32", value_parser = named::<WeightStorage>(&WEIGHTS))]
    pub(super) weights: WeightStorage,

    /// Name of the model, reported with every motion
    #[arg(long, default_value = "bailando-official")]
    pub(super) name: String,

    /// Licence of the weights, as their owner gives it
    #[arg(
        long,
        default_value = "non-commercial, as given by the authors of the published weights"
    )]
    pub(super) licence: String,

    /// Height in metres at which the pelvis starts above the floor
    #[arg(long, default_value_t = 0.93, value_name = "METRES", value_parser = root_height)]
    pub(super) root_height: f32,

    /// JSON object that says how the model was trained; copied into the manifest
    #[arg(long, value_name = "FILE.json")]
    pub(super) training: Option<PathBuf>,

    /// Replace the model that is already in DIR
    #[arg(long)]
    pub(super) force: bool,
}

/// Names of the feature profiles and of the ways to store weights, as in settings and manifests.
const PROFILES: [&str; 2] = ["librosa-0.11", "librosa-0.8.1"];
const WEIGHTS: [&str; 3] = ["f16", "f32", "int8"];

/// Parses one of `names`.
fn named<T: DeserializeOwned + Clone + Send + Sync + 'static>(
    names: &'static [&'static str],
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(names).try_map(|name| serde_json::from_value(name.into()))
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

impl SettingsArguments {
    /// Reads the settings, with the folders of the command line.
    pub(super) fn read(&self) -> anyhow::Result<Config> {
        let mut config = Config::read(&self.config)?;
        config.data.replace_folders(&self.data);
        if let Some(cache) = &self.cache {
            config.data.cache.clone_from(cache);
        }
        Ok(config)
    }
}

impl StageArguments {
    pub(super) fn limits(&self, stop: Option<&'static StopFlag>) -> Limits {
        Limits { seconds: self.max_seconds, steps: self.max_steps, stop }
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
                profile: arguments.profile,
                count_periods: Vec::new(),
                counts: CountSource::default(),
                styles: Vec::new(),
                energy: false,
                classifier: None,
                start_codes: Vec::new(),
                style_start_codes: BTreeMap::new(),
                style_codes: BTreeMap::new(),
                suppressed_codes: SuppressedCodes::default(),
                temperature: arguments.temperature,
                guidance: 1.0,
                candidates: 1,
                redo: false,
                hop: PUBLISHED_HOP,
                motion_frame: MotionFrame::World,
                root_height: arguments.root_height,
                weights: arguments.weights,
                training: BTreeMap::new(),
            },
        }
    }
}
