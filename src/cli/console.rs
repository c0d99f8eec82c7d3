//! Lines on the terminal, files, and checks of arguments that commands share.

use std::{
    fs,
    io::{self, Write},
    path::Path,
};

use anyhow::Context;

/// A wrong use of the command line that only shows after parsing.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct Usage(pub(super) String);

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

/// Reads a file; the error names it.
pub(super) fn read_file(path: &Path) -> anyhow::Result<Vec<u8>> {
    fs::read(path).with_context(|| path.display().to_string())
}

/// Writes a file; the error names it.
pub(super) fn write_file(path: &Path, content: impl AsRef<[u8]>) -> anyhow::Result<()> {
    fs::write(path, content).with_context(|| path.display().to_string())
}
