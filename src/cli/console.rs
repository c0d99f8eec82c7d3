//! Lines on the terminal, files, and checks of arguments that commands share.

use std::{
    fs,
    io::{self, Read, Write},
    path::Path,
    sync::OnceLock,
};

use anyhow::Context;
pub(super) use bailando::server::at_least_one;

/// A wrong use of the command line that only shows after parsing.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct Usage(pub(super) String);

/// How much a command says beside its result.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(super) struct Talk {
    /// Say nothing but results, warnings and errors
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Say also how long each stage took
    #[arg(short, long, global = true)]
    verbose: bool,
}

static TALK: OnceLock<Talk> = OnceLock::new();

impl Talk {
    /// Holds for the process.
    pub(super) fn hold(self) {
        // Only `run` sets it.
        let _ = TALK.set(self);
    }

    fn of_process() -> Self {
        TALK.get().copied().unwrap_or_default()
    }

    pub(super) fn is_quiet() -> bool {
        Self::of_process().quiet
    }
}

/// Standard input as the file to read, standard output as the file to write.
pub(super) const STANDARD: &str = "-";

/// Writes one line about what was done to standard error, unless the command is to be quiet.
pub(super) fn note(line: &str) {
    if !Talk::is_quiet() {
        say_error(line);
    }
}

/// Writes one line to standard error where the command is to say more.
pub(super) fn detail(line: &str) {
    if Talk::of_process().verbose {
        say_error(line);
    }
}

/// An error with its causes, each said once: many errors say their cause themselves.
pub(super) fn with_causes(error: &anyhow::Error) -> String {
    let mut said: Vec<String> = Vec::new();
    for cause in error.chain().map(ToString::to_string) {
        if said.last().is_none_or(|last| !last.ends_with(&cause)) {
            said.push(cause);
        }
    }
    said.join(": ")
}

/// Parses seconds above 0, for limits: NaN would switch one off.
pub(super) fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected seconds above 0".into()),
    }
}

/// Writes one line to standard output. A closed reader is no failure of the command.
pub(super) fn say(line: &str) {
    let _ = writeln!(io::stdout(), "{line}");
}

/// Writes one line to standard error.
pub(super) fn say_error(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Reads a file, or standard input; the error names it.
pub(super) fn read_file(path: &Path) -> anyhow::Result<Vec<u8>> {
    let read = match path.as_os_str() == STANDARD {
        true => {
            let mut bytes = Vec::new();
            io::stdin().lock().read_to_end(&mut bytes).map(|_| bytes)
        }
        false => fs::read(path),
    };
    read.with_context(|| path.display().to_string())
}

/// Writes a file, or to standard output; the error names it.
pub(super) fn write_file(path: &Path, content: impl AsRef<[u8]>) -> anyhow::Result<()> {
    let written = match path.as_os_str() == STANDARD {
        true => io::stdout().lock().write_all(content.as_ref()),
        false => fs::write(path, content),
    };
    written.with_context(|| path.display().to_string())
}
