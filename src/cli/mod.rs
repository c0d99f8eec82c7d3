//! The command line: parse, call, print.

mod bench;
mod codebook;
mod console;
mod evaluate;
mod features;
mod generate;
mod healthcheck;
mod inputs;
mod output;
mod progress;
mod serve;

use std::process::ExitCode;

use bailando::{Error, engine::EngineError, evaluation::EvaluationError};
use clap::{Parser, Subcommand};
use console::{Usage, say_error};

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
    /// Compare generated motion with recordings: FID, diversity, beat align score and more
    Evaluate(Box<evaluate::EvaluateArgs>),
    /// Draw each pose code of a model: a sheet per half of the body, and numbers
    Codebook(codebook::CodebookArgs),
    /// Measure the speed of a model on this machine: stages, steps, many dances at once, long songs
    Bench(bench::BenchArgs),
    /// Ask a running server whether it is alive; for container probes
    Healthcheck(healthcheck::HealthcheckArgs),
}

/// Parses the command line, runs the command and returns its exit code.
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
    let option = |error: &Error| {
        matches!(
            error,
            Error::Engine(EngineError::Option { .. })
                | Error::Evaluation(EvaluationError::Option(_))
        )
    };
    error.is::<Usage>() || error.downcast_ref::<Error>().is_some_and(option)
}
