//! `bailando healthcheck`: exit code for container probes.

use std::{
    net::{IpAddr, Ipv4Addr},
    time::Duration,
};

use anyhow::Context;
use bailando::server::ServerConfig;

use super::console::Usage;

/// Ask a running server whether it is alive; for container probes
#[derive(Debug, clap::Args)]
pub(super) struct HealthcheckArgs {
    /// Address to ask: /health says that the server runs, /ready that it accepts songs [default:
    /// /health at host and port]
    #[arg(long, env = "BAILANDO_HEALTH_URL")]
    url: Option<String>,
    /// Address that the server listens on
    #[arg(long, env = "BAILANDO_HOST", default_value_t = ServerConfig::default().host)]
    host: String,
    /// Port that the server listens on
    #[arg(long, env = "BAILANDO_PORT", default_value_t = ServerConfig::default().port)]
    port: u16,
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
    let url = args.url()?;
    let agent = ureq::Agent::new_with_config(
        ureq::Agent::config_builder()
            .timeout_global(Some(Duration::from_secs_f64(args.timeout)))
            // The server is on this machine, which a proxy cannot reach.
            .proxy(None)
            .build(),
    );
    agent.get(&url).call().with_context(|| format!("{url} gives no good answer"))?;
    Ok(())
}

impl HealthcheckArgs {
    fn url(&self) -> Result<String, Usage> {
        match (&self.url, self.port) {
            (Some(url), _) if !url.is_empty() => Ok(url.clone()),
            (_, 0) => Err(Usage(
                "a server on port 0 picks its own: give --url with the port that its log names"
                    .into(),
            )),
            (_, port) => Ok(format!("http://{}:{port}/health", reachable(&self.host))),
        }
    }
}

/// `host` as a URL names it. A server that listens on every interface is asked on the loopback.
fn reachable(host: &str) -> String {
    match host.parse() {
        Ok(IpAddr::V4(ip)) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.to_string(),
        // Where there is no IPv6 it listens on IPv4 alone.
        Ok(IpAddr::V6(ip)) if ip.is_unspecified() => "localhost".to_owned(),
        Ok(IpAddr::V6(ip)) => format!("[{ip}]"),
        _ => host.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_url_is_that_of_the_server() {
        let url = |url: Option<&str>, host: &str, port| {
            let args = HealthcheckArgs {
                url: url.map(str::to_owned),
                host: host.to_owned(),
                port,
                timeout: 1.0,
            };
            args.url().ok()
        };
        for (given, host, port, expected) in [
            (None, "127.0.0.1", 8080, "http://127.0.0.1:8080/health"),
            (None, "0.0.0.0", 9000, "http://127.0.0.1:9000/health"),
            (None, "::", 9000, "http://localhost:9000/health"),
            (None, "10.1.2.3", 80, "http://10.1.2.3:80/health"),
            (None, "fe80::1", 80, "http://[fe80::1]:80/health"),
            (None, "dance.local", 80, "http://dance.local:80/health"),
            (Some("http://x/ready"), "::", 0, "http://x/ready"),
            (Some(""), "::1", 1, "http://[::1]:1/health"),
        ] {
            assert_eq!(url(given, host, port).as_deref(), Some(expected));
        }
        assert_eq!(url(None, "127.0.0.1", 0), None);
    }
}
