//! `bailando healthcheck`: exit code for container probes.

use std::time::Duration;

use anyhow::Context;

/// Ask a running server whether it is alive; for container probes
#[derive(Debug, clap::Args)]
pub(super) struct HealthcheckArgs {
    /// What to ask: /health for alive, /ready for ready to dance
    #[arg(
        long,
        env = "BAILANDO_HEALTH_URL",
        default_value = "http://127.0.0.1:8080/health"
    )]
    url: String,
    /// Seconds to wait for the answer
    #[arg(long, default_value_t = 3.0, value_parser = parse_seconds)]
    timeout: f64,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.001..=3600.0).contains(&seconds) => Ok(seconds),
        _ => Err("expected seconds between 0.001 and 3600".into()),
    }
}

pub(super) fn run(args: &HealthcheckArgs) -> anyhow::Result<()> {
    let agent = ureq::Agent::new_with_config(
        ureq::Agent::config_builder()
            .timeout_global(Some(Duration::from_secs_f64(args.timeout)))
            .build(),
    );
    agent
        .get(&args.url)
        .call()
        .with_context(|| format!("{} does not answer well", args.url))?;
    Ok(())
}
