//! `bailando-train`: the offline binary.

use std::{
    io::{self, Write},
    process::ExitCode,
};

use bailando_train::{
    cli::{Arguments, run},
    training::StopFlag,
};
use clap::Parser;

/// Raised by SIGINT, SIGTERM and SIGHUP.
static STOP: StopFlag = StopFlag::new();
/// The exit code of a process that an interrupt ended, as shells have it.
const INTERRUPTED: u8 = 130;

/// Exit codes: 0 done, 1 failed (one line on standard error), 2 wrong usage (clap's own), 130
/// interrupted.
fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let handler = ctrlc::set_handler(|| {
        // Between steps, and the second time, there is nothing to wait for.
        if !STOP.request() {
            std::process::exit(INTERRUPTED.into());
        }
    });
    let done = handler
        .map_err(anyhow::Error::from)
        .and_then(|()| run(arguments, Some(&STOP), &mut io::stdout().lock()));
    match done {
        Ok(()) if STOP.is_requested() => ExitCode::from(INTERRUPTED),
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // With standard error closed there is nowhere to report.
            let _ = writeln!(io::stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}
