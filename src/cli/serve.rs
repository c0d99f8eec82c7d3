//! `bailando serve`: the HTTP server.

use bailando::server::{self, ServerConfig};

/// Run the HTTP server
#[derive(Debug, clap::Args)]
pub(super) struct ServeArgs {
    #[command(flatten)]
    config: ServerConfig,
}

pub(super) fn run(args: ServeArgs) -> anyhow::Result<()> {
    server::init_logging(args.config.json_output);
    server::start(&args.config)
}
