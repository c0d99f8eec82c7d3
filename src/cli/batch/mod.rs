//! `bailando batch`: a catalogue of songs, here or by a server; resumable.

mod local;
mod remote;
mod report;

use std::{
    fs,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::Mutex,
    thread,
};

use anyhow::Context;
use bailando::{formats::OutputFormat, options::RequestOptions};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use self::report::{Outcome, Report};
use super::{
    console::{Talk, Usage, note},
    inputs::{Input, audio_files},
    output::{FileFormat, targets_in},
};

/// Make dances for a catalogue of songs; run again, it makes what is missing
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct BatchArgs {
    /// Folders of songs, with their sub-folders, or songs
    #[arg(required = true)]
    songs: Vec<PathBuf>,
    /// Folder for the results, in the same sub-folders and named after their songs
    #[arg(short, long, value_name = "DIR")]
    out_dir: PathBuf,
    /// Format of the results
    #[arg(long, default_value = "bvh", value_parser = format)]
    format: OutputFormat,
    /// Address of a server that makes the dances, such as http://127.0.0.1:8080 [default: this
    /// process makes them]
    #[arg(long, env = "BAILANDO_SERVER")]
    server: Option<String>,
    /// Key of the server
    #[arg(long, env = "BAILANDO_API_KEY", hide_env_values = true, requires = "server")]
    api_key: Option<String>,
    /// Songs at the same time
    #[arg(long, default_value = "4")]
    at_once: NonZeroUsize,
    /// Make results that are there once more
    #[arg(long)]
    again: bool,
    /// File for the report: what was made, what failed and why [default: report.json in --out-dir]
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    #[command(flatten)]
    options: RequestOptions,
    /// Model directory, without --server
    #[arg(long, env = "BAILANDO_MODEL_DIR", default_value = "models/default")]
    model_dir: PathBuf,
    /// Threads that compute one step of the model, without --server [default: all cores]
    #[arg(long, env = "BAILANDO_THREADS")]
    threads: Option<NonZeroUsize>,
}

fn format(name: &str) -> Result<OutputFormat, String> {
    let names = || OutputFormat::ALL.map(OutputFormat::name).join(", ");
    name.parse().map_err(|_| format!("expected one of {}", names()))
}

/// Makes one dance: writes the file of a song's result.
trait Dancer: Sync {
    fn dance(&self, song: &Path, result: &Path) -> anyhow::Result<()>;
}

pub(super) fn run(args: &BatchArgs) -> anyhow::Result<()> {
    let inputs = audio_files(&args.songs, true)?;
    let targets = targets_in(&args.out_dir, FileFormat::Motion(args.format), &inputs)?;
    let dancer: Box<dyn Dancer> = match &args.server {
        Some(server) => Box::new(remote::Remote::new(server, args)?),
        None => Box::new(local::Local::open(args)?),
    };
    let bar = bar(inputs.len());
    let report = Mutex::new(Report::default());
    let songs: Mutex<Vec<_>> = Mutex::new(inputs.iter().zip(targets).rev().collect());
    let next = || songs.lock().ok()?.pop();
    thread::scope(|scope| {
        for _ in 0..args.at_once.get().min(inputs.len()) {
            scope.spawn(|| {
                while let Some((input, target)) = next() {
                    let outcome = match target {
                        Ok((target, _)) => one(args, dancer.as_ref(), input, &target),
                        Err(wrong) => Outcome::Failed(wrong.to_string()),
                    };
                    if let Outcome::Failed(why) = &outcome {
                        bar.suspend(|| note(&format!("error: {}: {why}", input.path.display())));
                    }
                    bar.inc(1);
                    if let Ok(mut report) = report.lock() {
                        report.add(&input.path, outcome);
                    }
                }
            });
        }
    });
    bar.finish_and_clear();
    let report = report.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    let file = args.report.clone().unwrap_or_else(|| args.out_dir.join("report.json"));
    report.write(&file)?;
    note(&format!("{}; {}", report.summary(), file.display()));
    anyhow::ensure!(report.failed() == 0, "{} of {} songs failed", report.failed(), inputs.len());
    Ok(())
}

/// Results appear under their names only when they are complete, so that what is there is done.
fn one(args: &BatchArgs, dancer: &dyn Dancer, input: &Input, target: &Path) -> Outcome {
    if target.exists() && !args.again {
        return Outcome::There;
    }
    let mut part = target.as_os_str().to_os_string();
    part.push(".part");
    let part = PathBuf::from(part);
    let made = dancer
        .dance(&input.path, &part)
        .and_then(|()| fs::rename(&part, target).with_context(|| target.display().to_string()));
    match made {
        Ok(()) => Outcome::Made,
        Err(error) => {
            // It may not be there.
            drop(fs::remove_file(&part));
            Outcome::Failed(format!("{error:#}"))
        }
    }
}

fn bar(songs: usize) -> ProgressBar {
    const TEMPLATE: &str = "[{bar:32}] {pos}/{len} songs, {eta} left";
    let bar = ProgressBar::new(songs as u64);
    if Talk::is_quiet() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    if let Ok(style) = ProgressStyle::with_template(TEMPLATE) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar
}

/// A wrong option is wrong for every song.
fn refuse(error: impl std::fmt::Display) -> anyhow::Error {
    Usage(error.to_string()).into()
}
