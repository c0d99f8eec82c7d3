//! `bailando batch`: a catalogue of songs, here or by a server; resumable.

mod args;
mod dancer;
mod local;
mod record;
mod remote;
mod report;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    thread,
};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

pub(super) use self::args::BatchArgs;
use self::{
    dancer::Dancer,
    record::Record,
    report::{Outcome, Report},
};
use super::{
    console::{Talk, note, say_error, with_causes},
    inputs::{Input, audio_files},
    output::{FileFormat, targets_in},
};

pub(super) fn run(args: &BatchArgs) -> anyhow::Result<()> {
    let inputs = audio_files(&args.songs, true)?;
    let targets = targets_in(&args.out_dir, FileFormat::Motion(args.format), &inputs)?;
    let dancer: Box<dyn Dancer> = match &args.server {
        Some(server) => Box::new(remote::Remote::new(server, args)?),
        None => Box::new(local::Local::open(args)?),
    };
    let record = Record::open(&args.out_dir, args.query())?;
    let bar = bar(inputs.len());
    let report = Mutex::new(Report::default());
    let songs: Mutex<Vec<_>> = Mutex::new(inputs.iter().zip(targets).rev().collect());
    let next = || songs.lock().ok()?.pop();
    thread::scope(|scope| {
        for _ in 0..args.at_once.get().min(inputs.len()) {
            scope.spawn(|| {
                while let Some((input, target)) = next() {
                    let outcome = match target {
                        Ok((target, _)) => one((args, dancer.as_ref()), &record, input, &target),
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
    let report = report.into_inner().unwrap_or_else(PoisonError::into_inner);
    let file = args.report.clone().unwrap_or_else(|| args.out_dir.join("report.json"));
    report.write(&file)?;
    if let Some(warning) = report.warning() {
        say_error(&format!("warning: {warning}"));
    }
    note(&format!("{}; {}", report.summary(), file.display()));
    anyhow::ensure!(report.failed() == 0, "{} of {} songs failed", report.failed(), inputs.len());
    Ok(())
}

/// Results appear under their names only when they are complete, so that what is there is done.
fn one(
    (args, dancer): (&BatchArgs, &dyn Dancer),
    record: &Record,
    input: &Input,
    target: &Path,
) -> Outcome {
    if target.exists() && !args.again {
        return if record.differs(target) { Outcome::Otherwise } else { Outcome::There };
    }
    let mut part = target.as_os_str().to_os_string();
    part.push(".part");
    let part = PathBuf::from(part);
    let made = dancer
        .dance(&input.path, &part)
        .and_then(|()| record.note(target))
        .and_then(|()| fs::rename(&part, target).with_context(|| target.display().to_string()));
    match made {
        Ok(()) => Outcome::Made,
        Err(error) => {
            // It may not be there.
            drop(fs::remove_file(&part));
            Outcome::Failed(why(error, &input.path))
        }
    }
}

/// The reason without the song, which the report names beside it.
fn why(error: anyhow::Error, song: &Path) -> String {
    let song = song.display().to_string();
    let said = with_causes(&error.context(song.clone()));
    said.strip_prefix(&format!("{song}: ")).unwrap_or(&said).to_owned()
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
