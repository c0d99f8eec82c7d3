//! The log: lines on standard error, for people or for programs.

use std::io::{IsTerminal, stderr};

use tracing_subscriber::EnvFilter;

/// Everything of level info and above, but from libraries, which tell of every upload, only warnings.
const DEFAULT_FILTER: &str = "info,symphonia=warn,ort=warn";

/// Starts the log of this process; `RUST_LOG` chooses what is in it. A second call changes
/// nothing.
pub fn init_logging(json: bool) {
    let filter =
        EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(DEFAULT_FILTER));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(stderr().is_terminal())
        .with_writer(stderr);
    // Fails only when there is a log already.
    let _ = if json {
        log.json().try_init()
    } else {
        log.try_init()
    };
}
