//! `bailando serve`: the HTTP server.

use anyhow::Context;
use bailando::server::{self, ServeError, ServerConfig, StorageError};

use super::console::Usage;

/// Run the HTTP server
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct ServeArgs {
    #[command(flatten)]
    config: ServerConfig,
}

pub(super) fn run(args: &ServeArgs) -> anyhow::Result<()> {
    // Dropped at the end: it sends the remaining traces.
    let _telemetry =
        server::init_telemetry(args.config.json_output, args.config.otlp_endpoint.as_deref())?;
    match server::start(&args.config) {
        Err(ServeError::Limits(contradiction)) => Err(Usage(contradiction.to_string()).into()),
        Err(ServeError::Storage(
            wrong @ (StorageError::NothingShared | StorageError::NoSecret),
        )) => Err(Usage(wrong.to_string()).into()),
        ended => ended.context("the server failed"),
    }
}
