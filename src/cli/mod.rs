//! The command line: parse, call, print.

mod bench;
mod codebook;
mod evaluate;
mod features;
mod generate;
mod healthcheck;
mod inputs;
mod output;
mod progress;
mod serve;

use std::{
    io::{self, Write},
    process::ExitCode,
};

use bailando::{engine::EngineError, evaluation::EvaluationError};
use clap::{Parser, Subcommand};

/// Music in, dance out: 3-D dance for a song.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed, 2 wrong use of the command line.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the HTTP server
    Serve(Box<serve::ServeArgs>),
    /// Make dances from audio files, or codes and positions from feature rows
    Generate(Box<generate::GenerateArgs>),
    /// Write a song's music features as a NumPy file
    Features(features::FeaturesArgs),
    /// Compare generated dances with recordings: FID, diversity, beat align score and more
    Evaluate(Box<evaluate::EvaluateArgs>),
    /// Draw what each pose code of a model looks like: a sheet per half body, and numbers
    Codebook(codebook::CodebookArgs),
    /// Measure how fast a model is on this machine: stages, steps, many dances at once, long songs
    Bench(bench::BenchArgs),
    /// Ask a running server whether it is alive; for container probes
    Healthcheck(healthcheck::HealthcheckArgs),
}

/// A wrong use of the command line that only shows after parsing.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Usage(String);

/// Parses the command line, runs it and says how it went.
pub(crate) fn run() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Serve(args) => serve::run(&args),
        Command::Generate(args) => generate::run(&args),
        Command::Features(args) => features::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Codebook(args) => codebook::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Healthcheck(args) => healthcheck::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say_error(&format!("error: {error:#}"));
            ExitCode::from(if is_usage(&error) { 2 } else { 1 })
        }
    }
}

fn is_usage(error: &anyhow::Error) -> bool {
    error.is::<Usage>()
        || matches!(error.downcast_ref(), Some(EngineError::Option { .. }))
        || matches!(error.downcast_ref(), Some(EvaluationError::Option(_)))
}

/// Seconds above 0, for limits: NaN would switch one off.
fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected seconds above 0".into()),
    }
}

/// One line on standard output. A reader that has gone is no failure of ours.
fn say(line: &str) {
    let _ = writeln!(io::stdout(), "{line}");
}

/// One line on standard error.
fn say_error(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}
