//! `bailando generate`: the server's work without HTTP.

use std::{
    fs,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use anyhow::Context;
use bailando::{
    audio::{AudioLimits, AudioRange},
    engine::{Engine, EngineConfig, GenerationOptions, GenerationRequest, MAX_CANDIDATES},
    features::{COLUMNS, with_counts},
    formats::{Codes, Continuation, GeneratedMotion},
    model::WindowKind,
    motion,
    npy::read_array,
};
use clap::{ArgAction, ValueEnum};
use ndarray::Array2;

use super::{
    console::{Usage, positive_seconds, say, say_error},
    inputs::audio_files,
    output::{FileFormat, OutputArgs, check_folder_of, write_positions},
    progress::Bar,
};

/// Make dances from audio files, or codes and positions from feature rows
#[derive(Debug, clap::Args)]
pub(super) struct GenerateArgs {
    /// Songs (wav, flac, mp3, ogg/vorbis, m4a/aac) or folders of them
    #[arg(required_unless_present = "features", conflicts_with = "features")]
    audio: Vec<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
    /// Model directory
    #[arg(long, env = "BAILANDO_MODEL_DIR", default_value = "models/default")]
    model_dir: PathBuf,
    /// Threads that compute one step of the model [default: all cores]
    #[arg(long, env = "BAILANDO_THREADS")]
    threads: Option<NonZeroUsize>,
    #[command(flatten)]
    sampling: SamplingArgs,
    /// The `tail` in the JSON of an earlier dance, which the new one continues
    #[arg(long, value_name = "TAIL")]
    continue_from: Option<Continuation>,
    #[command(flatten)]
    song: SongArgs,
    #[command(flatten)]
    rows: RowsArgs,
}

/// How the dance is chosen; absent options have the model's own defaults.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Sampling")]
struct SamplingArgs {
    /// The same seed and song give the same dance; drawn if absent
    #[arg(long)]
    seed: Option<u64>,
    /// 0 takes the most likely code, as in the paper; higher is freer
    #[arg(long)]
    temperature: Option<f32>,
    /// Draw from this many most likely codes only
    #[arg(long)]
    top_k: Option<usize>,
    /// How strongly the dance follows the music's beat: 1 as the model predicts, above it more so,
    /// below it less; other than 1 costs twice as much
    #[arg(long)]
    guidance: Option<f32>,
    /// Candidates for every two to four seconds of dance; the best is kept: its beats lie nearest
    /// to the music's, and few of its frames stand still. The cost grows with them. Always one
    /// with --features, which carry no beats
    #[arg(long)]
    candidates: Option<usize>,
    /// Whether two to four seconds of dance in which the dancer stands still (of several candidates
    /// also: goes to the ground) are generated again, up to three times and with at most 12
    /// candidates in all [default: the model's, and true with several candidates]
    #[arg(long, value_name = "BOOL")]
    redo: Option<bool>,
    /// First pose code of the upper body
    #[arg(long)]
    start_upper: Option<u32>,
    /// First pose code of the lower body
    #[arg(long)]
    start_lower: Option<u32>,
    /// How the window of past codes moves: hop is fast, sliding is what the paper's code does
    #[arg(long, value_enum)]
    window: Option<WindowArg>,
    /// Codes kept when a hop window shrinks
    #[arg(long)]
    hop: Option<usize>,
}

/// How the song is used.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Song and motion")]
struct SongArgs {
    /// Where in the song to begin, in seconds
    #[arg(long, default_value_t = 0.0)]
    offset_s: f64,
    /// How much of the song to use, in seconds
    #[arg(long)]
    duration_s: Option<f64>,
    /// Frames per second: 20, 24, 30 or 60
    #[arg(long, default_value_t = 60)]
    fps: u32,
    /// Whether the dancer travels; false keeps it in place
    #[arg(long, default_value_t = true, action = ArgAction::Set, value_name = "BOOL")]
    root_motion: bool,
    /// Find the music's tempo and beats [default: true for JSON]
    #[arg(long, action = ArgAction::Set, value_name = "BOOL")]
    music: Option<bool>,
    /// Longest song in seconds
    #[arg(
        long,
        env = "BAILANDO_MAX_AUDIO_SECONDS",
        default_value_t = AudioLimits::default().max_seconds,
        value_parser = positive_seconds
    )]
    max_audio_seconds: f64,
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
            "output", "out_dir", "include_rotations", "encoding", "bvh_unit", "offset_s",
            "duration_s", "fps", "root_motion", "music", "max_audio_seconds", "candidates",
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

#[derive(Clone, Copy, Debug, ValueEnum)]
enum WindowArg {
    Hop,
    Sliding,
}

pub(super) fn run(args: &GenerateArgs) -> anyhow::Result<()> {
    match &args.rows.features {
        Some(features) => from_rows(args, features),
        None => from_audio(args),
    }
}

impl GenerateArgs {
    fn open(&self) -> anyhow::Result<Engine> {
        let defaults = EngineConfig::new(&self.model_dir);
        Ok(Engine::open(&EngineConfig {
            threads: self.threads.map_or(defaults.threads, NonZeroUsize::get),
            // Enough for all that the options allow.
            batch: 2 * MAX_CANDIDATES,
            audio: AudioLimits {
                max_seconds: self.song.max_audio_seconds,
                ..AudioLimits::default()
            },
            ..defaults
        })?)
    }

    fn options(&self, music: bool) -> GenerationOptions {
        let SamplingArgs {
            seed,
            temperature,
            top_k,
            guidance,
            candidates,
            redo,
            start_upper,
            start_lower,
            window,
            hop,
        } = self.sampling;
        GenerationOptions {
            seed,
            temperature,
            top_k,
            guidance,
            candidates,
            redo,
            start_upper,
            start_lower,
            continue_from: self.continue_from.clone(),
            window: window.map(|window| match window {
                WindowArg::Hop => WindowKind::Hop,
                WindowArg::Sliding => WindowKind::Sliding,
            }),
            hop,
            range: AudioRange {
                offset_s: self.song.offset_s,
                duration_s: self.song.duration_s,
            },
            fps: self.song.fps,
            root_motion: self.song.root_motion,
            music: self.song.music.unwrap_or(music),
        }
    }
}

/// Tries every song; fails at the end when one did not work.
fn from_audio(args: &GenerateArgs) -> anyhow::Result<()> {
    let inputs = audio_files(&args.audio)?;
    let targets = args.output.targets(&inputs)?;
    let engine = args.open()?;
    engine.check(&args.options(false))?;
    let mut first_failure = None;
    let mut failures = 0;
    for (input, (target, format)) in inputs.iter().zip(&targets) {
        if let Err(error) = one_song(args, &engine, input, target, *format) {
            let error = error.context(input.display().to_string());
            failures += 1;
            match inputs.len() {
                1 => return Err(error),
                _ => say_error(&format!("error: {error:#}")),
            }
            first_failure.get_or_insert(error);
        }
    }
    match first_failure {
        None => Ok(()),
        Some(_) => anyhow::bail!(
            "{failures} of {} songs could not be danced to",
            inputs.len()
        ),
    }
}

fn one_song(
    args: &GenerateArgs,
    engine: &Engine,
    input: &Path,
    target: &Path,
    format: FileFormat,
) -> anyhow::Result<()> {
    let started = Instant::now();
    let audio = fs::read(input)?;
    let options = args.options(format == FileFormat::Json);
    let bar = Arc::new(Bar::new(&input.display().to_string()));
    let request = GenerationRequest::audio(audio, options).with_progress(Arc::clone(&bar) as _);
    let output = engine.generate(request)?;
    let dance = output.into_motion(engine.manifest());
    drop(bar);
    args.output.write(&dance, target, format)?;
    report(&dance, target, started);
    Ok(())
}

fn report(dance: &GeneratedMotion, target: &Path, started: Instant) {
    for warning in &dance.warnings {
        say_error(&format!("warning: {warning}"));
    }
    say(&format!(
        "{}: {} frames at {} fps, seed {}, in {:.2} s",
        target.display(),
        dance.animation.root.len(),
        dance.animation.fps,
        dance.seed,
        started.elapsed().as_secs_f64()
    ));
}

fn from_rows(args: &GenerateArgs, features: &Path) -> anyhow::Result<()> {
    let RowsArgs {
        codes_out,
        positions_out,
        ..
    } = &args.rows;
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
    let request = GenerationRequest::features(rows, args.options(false)).with_progress(bar);
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
    let bytes = fs::read(path).with_context(|| path.display().to_string())?;
    read_array(&bytes).with_context(|| format!("{}: not a matrix of float32", path.display()))
}

/// Codes as int64 [2, codes], upper then lower.
fn codes_array(codes: &Codes) -> Array2<i64> {
    let halves = [&codes.upper, &codes.lower];
    Array2::from_shape_fn((2, codes.upper.len()), |(half, index)| {
        halves
            .get(half)
            .and_then(|half| half.get(index))
            .map_or(0, |&code| i64::from(code))
    })
}
