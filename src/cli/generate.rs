//! `bailando generate`: the server's work without HTTP.

use std::{
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use anyhow::Context;
use bailando::{
    audio::AudioLimits,
    engine::{Engine, EngineConfig, GenerationRequest, MAX_CANDIDATES},
    features::{COLUMNS, with_counts},
    formats::{Character, Codes, GeneratedMotion, OutputFormat},
    model::Device,
    motion,
    npy::read_array,
    options::RequestOptions,
};
use bytes::Bytes;
use ndarray::Array2;

use super::{
    codes::read_codes,
    console::{
        STANDARD, Talk, Usage, at_least_one, detail, note, positive_seconds, read_file, say,
        say_error, with_causes, write_file,
    },
    inputs::{Input, audio_files},
    output::{FileFormat, OutputArgs, check_folder_of, write_positions},
    progress::Bar,
    rig::RigArgs,
};

/// Make dances from audio files, or codes and positions from feature rows
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct GenerateArgs {
    /// Songs (wav, aiff, flac, mp3, ogg, webm, m4a), folders of them, or `-` for standard input
    #[arg(
        required_unless_present_any = ["features", "codes", "print_mapping"],
        conflicts_with_all = ["features", "print_mapping"]
    )]
    audio: Vec<PathBuf>,
    /// Look for songs in sub-folders too; --out-dir gets the same sub-folders
    #[arg(long, conflicts_with = "features")]
    recursive: bool,
    #[command(flatten)]
    output: OutputArgs,
    /// Dance these pose codes instead of choosing them by the song, which may then be left out: a
    /// dance's JSON, its `codes`, pairs [[upper, lower], ..], or int64 [2, codes] as npy
    #[arg(long, value_name = "F.{json,npy}", conflicts_with = "features")]
    codes: Option<PathBuf>,
    #[command(flatten)]
    options: RequestOptions,
    /// Model directory
    #[arg(long, env = "BAILANDO_MODEL_DIR", default_value = "models/default")]
    model_dir: PathBuf,
    /// What computes the model: cpu, cuda or cuda:N
    #[arg(long, env = "BAILANDO_DEVICE", default_value_t = Device::Cpu)]
    device: Device,
    /// Threads that compute one step of the model [default: all cores]
    #[arg(long, env = "BAILANDO_THREADS", value_parser = at_least_one::<NonZeroUsize>)]
    threads: Option<NonZeroUsize>,
    /// Longest song in seconds
    #[arg(
        long,
        env = "BAILANDO_MAX_AUDIO_SECONDS",
        default_value_t = AudioLimits::default().max_seconds,
        value_parser = positive_seconds
    )]
    max_audio_seconds: f64,
    #[command(flatten)]
    rig: RigArgs,
    #[command(flatten)]
    rows: RowsArgs,
}

/// From feature rows instead of audio.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Feature rows instead of audio")]
struct RowsArgs {
    /// Feature rows, float32 [rows, columns of the model], as `bailando features --model-dir`
    /// writes them; with 438 columns, the dance does not follow the music's counts
    #[arg(
        long,
        value_name = "F.npy",
        conflicts_with_all = [
            "output", "out_dir", "include_rotations", "encoding", "bvh_unit", "skeleton",
            "mannequin", "offset_s", "duration_s", "fps", "root_motion", "mirror", "clean",
            "positions", "bars", "loop", "music", "max_audio_seconds", "candidates",
        ]
    )]
    features: Option<PathBuf>,
    /// Where the pose codes go: int64 [2, codes], upper then lower
    #[arg(long, value_name = "C.npy", requires = "features")]
    codes_out: Option<PathBuf>,
    /// Where the joint positions go: float32 [8 codes, 24, 3], metres, root beginning at 0
    #[arg(long, value_name = "P.npy", requires = "features")]
    positions_out: Option<PathBuf>,
}

pub(super) fn run(args: &GenerateArgs) -> anyhow::Result<()> {
    if args.rig.print_mapping {
        return print_mapping(&args.rig);
    }
    match &args.rows.features {
        Some(features) => from_rows(args, features),
        None => from_audio(args),
    }
}

fn print_mapping(rig: &RigArgs) -> anyhow::Result<()> {
    if let Some(rig) = rig.read()? {
        say(&serde_json::to_string_pretty(rig.mapping())?);
    }
    Ok(())
}

impl GenerateArgs {
    /// The options, with the codes of their file.
    fn options(&self) -> anyhow::Result<RequestOptions> {
        let options = self.options.clone();
        match &self.codes {
            Some(path) => Ok(options.with_codes(read_codes(path)?)),
            None => Ok(options),
        }
    }

    fn open(&self) -> anyhow::Result<Engine> {
        let defaults = EngineConfig::new(&self.model_dir);
        Ok(Engine::open(&EngineConfig {
            device: self.device,
            threads: self.threads.map_or(defaults.threads, NonZeroUsize::get),
            // Enough for all that the options allow.
            batch: 2 * MAX_CANDIDATES,
            audio: AudioLimits { max_seconds: self.max_audio_seconds, ..AudioLimits::default() },
            ..defaults
        })?)
    }
}

/// Tries every song; fails at the end when one did not work.
fn from_audio(args: &GenerateArgs) -> anyhow::Result<()> {
    let inputs = match &args.codes {
        Some(codes) if args.audio.is_empty() => vec![Input::of(codes)],
        _ => audio_files(&args.audio, args.recursive)?,
    };
    let rig = args.rig.read()?;
    let targets = args.output.targets(&inputs, rig.as_ref().map(Character::format))?;
    let options = args.options()?;
    let engine = args.open()?;
    engine.check(&options.generation(OutputFormat::Bvh))?;
    let mut failures = 0;
    let songs = inputs.len();
    for (input, target) in inputs.iter().zip(targets) {
        let danced = target.map_err(anyhow::Error::from);
        let danced = danced.and_then(|target| {
            one_song((args, &options, rig.as_ref()), &engine, &input.path, target)
        });
        if let Err(error) = danced {
            let error = error.context(input.path.display().to_string());
            failures += 1;
            match songs {
                1 => return Err(error),
                _ => say_error(&format!("error: {}", with_causes(&error))),
            }
        }
    }
    anyhow::ensure!(failures == 0, "{failures} of {songs} songs could not be danced to");
    Ok(())
}

fn one_song(
    (args, options, rig): (&GenerateArgs, &RequestOptions, Option<&Character>),
    engine: &Engine,
    input: &Path,
    (target, format): (PathBuf, FileFormat),
) -> anyhow::Result<()> {
    let started = Instant::now();
    let target = target.as_path();
    let audio = match args.audio.is_empty() {
        true => None,
        false => Some(Bytes::from(read_file(input)?)),
    };
    let bar = Arc::new(Bar::new(&input.display().to_string()));
    let dance = options.dance(format.motion(), |generation| {
        let request = match &audio {
            None => GenerationRequest::codes(generation),
            Some(audio) => GenerationRequest::audio(audio.clone(), generation),
        };
        let output = engine.generate(request.with_progress(Arc::clone(&bar) as _))?;
        anyhow::Ok(output.into_motion(engine.manifest()))
    })?;
    drop(bar);
    match rig {
        Some(rig) => write_file(target, rig.dance(&dance, options.plants_feet())?)?,
        None => args.output.write(&dance, target, format, options)?,
    }
    detail(&format!("milliseconds: {}", serde_json::to_string(&dance.timings)?));
    report(&dance, target, started);
    Ok(())
}

fn report(dance: &GeneratedMotion, target: &Path, started: Instant) {
    for warning in &dance.warnings {
        say_error(&format!("warning: {warning}"));
    }
    // Standard output carries the dance itself.
    let tell = if target.as_os_str() == STANDARD { note } else { say_unless_quiet };
    tell(&format!(
        "{}: {} frames at {} fps, seed {}, in {:.2} s",
        target.display(),
        dance.animation.root.len(),
        dance.animation.fps,
        dance.seed,
        started.elapsed().as_secs_f64()
    ));
}

fn say_unless_quiet(line: &str) {
    if !Talk::is_quiet() {
        say(line);
    }
}

fn from_rows(args: &GenerateArgs, features: &Path) -> anyhow::Result<()> {
    let RowsArgs { codes_out, positions_out, .. } = &args.rows;
    if codes_out.is_none() && positions_out.is_none() {
        return Err(Usage("say what to write: --codes-out or --positions-out".into()).into());
    }
    for path in [codes_out, positions_out].into_iter().flatten() {
        check_folder_of(path)?;
    }
    let rows = read_rows(features)?;
    let engine = args.open()?;
    let rows = with_columns_of(&engine, rows, args, features);
    let bar = Arc::new(Bar::new(&features.display().to_string()));
    let request = GenerationRequest::features(rows, args.options.generation(OutputFormat::Bvh))
        .with_progress(bar);
    let output = engine.generate(request)?;
    let (codes, seed) = (output.codes.upper.len(), output.seed);
    if let Some(path) = codes_out {
        ndarray_npy::write_npy(path, &codes_array(&output.codes))
            .with_context(|| path.display().to_string())?;
    }
    if let Some(path) = positions_out {
        let positions = motion::integrate_root(output.into_decoded().view(), [0.0; 3])?;
        write_positions(path, &positions)?;
    }
    say(&format!("{codes} code pairs, seed {seed}"));
    Ok(())
}

/// Rows of 438 columns know no counts: to a model with count columns, they are those of a song
/// without regular beats.
fn with_columns_of(
    engine: &Engine,
    rows: Array2<f32>,
    args: &GenerateArgs,
    path: &Path,
) -> Array2<f32> {
    let wanted = &engine.manifest().features;
    if rows.ncols() != COLUMNS || wanted.columns == COLUMNS {
        return rows;
    }
    let (file, model) = (path.display(), args.model_dir.display());
    say_error(&format!(
        "warning: {file} has no count columns, so the dance does not follow the music's counts; \
         `bailando features SONG -o {file} --model-dir {model}` writes them"
    ));
    with_counts(rows, None, 0.0, &wanted.count_periods)
}

fn read_rows(path: &Path) -> anyhow::Result<Array2<f32>> {
    let bytes = read_file(path)?;
    read_array(&bytes).with_context(|| format!("{}: not a matrix of float32", path.display()))
}

/// Codes as int64 [2, codes], upper then lower.
fn codes_array(codes: &Codes) -> Array2<i64> {
    let halves = [&codes.upper, &codes.lower];
    Array2::from_shape_fn((2, codes.upper.len()), |(half, index)| {
        halves.get(half).and_then(|half| half.get(index)).map_or(0, |&code| i64::from(code))
    })
}
