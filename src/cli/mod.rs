//! The command line: parse, call, print.

mod batch;
mod bench;
mod codebook;
mod codes;
mod console;
mod evaluate;
mod features;
mod generate;
mod healthcheck;
mod inputs;
mod output;
mod progress;
mod render;
mod rig;
mod serve;
mod study;

use std::process::ExitCode;

use bailando::{engine::EngineError, evaluation::EvaluationError};
use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
use console::{Talk, Usage, say_error, with_causes};

/// Music in, dance out: 3-D dance for a song.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    talk: Talk,
}

const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed, 2 wrong use of the command line.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the HTTP server
    Serve(Box<serve::ServeArgs>),
    /// Make dances from audio files, or codes and positions from feature rows
    Generate(Box<generate::GenerateArgs>),
    /// Make dances for a catalogue of songs; run again, it makes what is missing
    Batch(Box<batch::BatchArgs>),
    /// Write a song's music features as a NumPy file
    Features(features::FeaturesArgs),
    /// Compare generated motion with recordings: FID, diversity, beat align score and more
    Evaluate(Box<evaluate::EvaluateArgs>),
    /// Ask people which of two dances is the better one to a song, and count their answers
    Study(study::StudyArgs),
    /// Draw a dance as a film or a picture, with the viewer's own scene
    Render(Box<render::RenderArgs>),
    /// Draw each pose code of a model: a sheet per half of the body, and numbers
    Codebook(codebook::CodebookArgs),
    /// Measure the speed of a model on this machine: stages, steps, many dances at once, long songs
    Bench(bench::BenchArgs),
    /// Ask a running server whether it is alive; for container probes
    Healthcheck(healthcheck::HealthcheckArgs),
    /// Write the script that completes this command line in a shell
    Completions {
        /// The shell
        shell: Shell,
    },
}

/// Parses the command line, runs the command and returns its exit code.
pub(crate) fn run() -> ExitCode {
    let Cli { command, talk } = Cli::parse();
    talk.hold();
    let result = match command {
        Command::Serve(args) => serve::run(&args),
        Command::Generate(args) => generate::run(&args),
        Command::Batch(args) => batch::run(&args),
        Command::Features(args) => features::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Study(args) => study::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Codebook(args) => codebook::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Healthcheck(args) => healthcheck::run(&args),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "bailando", &mut script);
            console::write_file(console::STANDARD.as_ref(), script)
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say_error(&format!("error: {}", with_causes(&error)));
            ExitCode::from(if is_usage(&error) { 2 } else { 1 })
        }
    }
}

fn is_usage(error: &anyhow::Error) -> bool {
    error.is::<Usage>()
        || matches!(error.downcast_ref(), Some(EngineError::Option { .. }))
        || matches!(error.downcast_ref(), Some(EvaluationError::Option(_)))
}
