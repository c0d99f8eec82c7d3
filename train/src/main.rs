//! `bailando-train`: the offline binary.

use std::{
    io::{self, Write},
    process::ExitCode,
};

use bailando_train::cli::{Arguments, run};
use clap::Parser;

/// Exit codes: 0 done, 1 failed (one line on standard error), 2 wrong usage (clap's own).
fn main() -> ExitCode {
    match run(Arguments::parse(), &mut io::stdout().lock()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // If standard error is closed there is no one left to tell.
            let _ = writeln!(io::stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}
