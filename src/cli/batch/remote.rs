//! Dances made by a server, as jobs. A batch that was interrupted finds its jobs again by their
//! idempotency keys.

use std::{
    fs::File,
    io::{self, Read},
    path::Path,
    thread::sleep,
    time::Duration,
};

use anyhow::Context;
use serde_json::Value;
use sha2::{Digest, Sha256};
use ureq::{Agent, Body, http::Response};

use super::{args::BatchArgs, dancer::Dancer};
use crate::cli::console::Usage;

/// Time between two questions about a job: the first, and the longest.
const ASK_AGAIN: Duration = Duration::from_millis(250);
const ASK_SELDOM: Duration = Duration::from_secs(4);
/// Waits for a server that does not answer, before a song has failed.
const UNREACHABLE: [u64; 5] = [1, 2, 5, 10, 30];
/// How often a song is ordered again that its server has no place for.
const MOST_REFUSALS: usize = 1000;
/// Longest error message that is read.
const LONGEST_ERROR: u64 = 64 * 1024;

pub(super) struct Remote {
    agent: Agent,
    server: String,
    key: Option<String>,
    /// Query of an order.
    query: String,
}

impl Remote {
    pub(super) fn new(server: &str, args: &BatchArgs) -> anyhow::Result<Self> {
        if !server.starts_with("http://") && !server.starts_with("https://") {
            let problem = "--server needs an address such as http://127.0.0.1:8080";
            return Err(Usage(problem.to_owned()).into());
        }
        let config = Agent::config_builder()
            .http_status_as_error(false)
            .timeout_connect(Some(Duration::from_secs(10)))
            .timeout_recv_response(Some(Duration::from_secs(150)));
        Ok(Self {
            agent: Agent::new_with_config(config.build()),
            server: server.trim_end_matches('/').to_owned(),
            key: args.api_key.clone().filter(|key| !key.is_empty()),
            query: args.query(),
        })
    }

    /// Sends a request until it is answered with something else than "later".
    fn ask(
        &self,
        what: &dyn Fn(&str) -> Result<Response<Body>, ureq::Error>,
    ) -> anyhow::Result<Response<Body>> {
        let key = self.key.as_deref().unwrap_or_default();
        let (mut unreachable, mut refusals) = (UNREACHABLE.iter(), 0);
        loop {
            let answer = match what(key) {
                Ok(answer) => answer,
                // Refused while it is restarted, for example.
                Err(error) => match unreachable.next() {
                    Some(wait) => {
                        sleep(Duration::from_secs(*wait));
                        continue;
                    }
                    None => return Err(anyhow::Error::new(error).context(self.server.clone())),
                },
            };
            let status = answer.status().as_u16();
            refusals += 1;
            if !matches!(status, 429 | 503) || refusals > MOST_REFUSALS {
                return Ok(answer);
            }
            let after = answer.headers().get("retry-after");
            let after = after.and_then(|text| text.to_str().ok()?.parse().ok());
            sleep(Duration::from_secs(after.unwrap_or(1_u64).clamp(1, 60)));
        }
    }

    fn get(&self, path: &str) -> anyhow::Result<Response<Body>> {
        let url = format!("{}{path}", self.server);
        self.ask(&|key| {
            let request = self.agent.get(&url);
            match key {
                "" => request.call(),
                key => request.header("x-api-key", key).call(),
            }
        })
    }

    /// Orders a song; where the job is asked about.
    fn order(&self, song: &Path) -> anyhow::Result<String> {
        let key = self.idempotency_key(song)?;
        let url = format!("{}/jobs?{}", self.server, self.query);
        let mut answer = self.ask(&|api_key| {
            let file = File::open(song)?;
            let mut request = self
                .agent
                .post(&url)
                .header("content-type", "application/octet-stream")
                .header("idempotency-key", &key);
            if !api_key.is_empty() {
                request = request.header("x-api-key", api_key);
            }
            request.send(&file)
        })?;
        let location = answer.headers().get("location").and_then(|path| path.to_str().ok());
        match (answer.status().as_u16(), location.map(str::to_owned)) {
            (202, Some(location)) => Ok(location),
            _ => Err(said(&mut answer)),
        }
    }

    fn idempotency_key(&self, song: &Path) -> io::Result<String> {
        let mut hash = Sha256::new();
        hash.update(&self.query);
        let mut file = File::open(song)?;
        let mut piece = vec![0; 1 << 16];
        loop {
            let read = file.read(&mut piece)?;
            if read == 0 {
                break;
            }
            hash.update(piece.get(..read).unwrap_or_default());
        }
        let hash = hash.finalize();
        Ok(format!("batch-{}", hash.iter().map(|byte| format!("{byte:02x}")).collect::<String>()))
    }

    /// Waits for a job. False if it is gone: it was made before, and its time is over.
    fn wait(&self, job: &str) -> anyhow::Result<bool> {
        let mut pause = ASK_AGAIN;
        loop {
            let mut answer = self.get(job)?;
            match answer.status().as_u16() {
                200 => {}
                404 => return Ok(false),
                _ => return Err(said(&mut answer)),
            }
            let status: Value = serde_json::from_reader(answer.body_mut().as_reader())?;
            match status["state"].as_str() {
                Some("done") => return Ok(true),
                Some("failed") => {
                    let why = status["error"]["error"].as_str().unwrap_or("the job failed");
                    anyhow::bail!("{why}");
                }
                _ => {}
            }
            sleep(pause);
            pause = (pause * 5 / 4).min(ASK_SELDOM);
        }
    }
}

impl Dancer for Remote {
    fn dance(&self, song: &Path, result: &Path) -> anyhow::Result<()> {
        let mut job = self.order(song)?;
        if !self.wait(&job)? {
            job = self.order(song)?;
            anyhow::ensure!(self.wait(&job)?, "the server has forgotten the job twice");
        }
        let mut answer = self.get(&format!("{job}/result"))?;
        if answer.status().as_u16() != 200 {
            return Err(said(&mut answer));
        }
        let mut file = File::create(result).with_context(|| result.display().to_string())?;
        io::copy(&mut answer.body_mut().as_reader(), &mut file).context("the result broke off")?;
        file.sync_all()?;
        Ok(())
    }
}

/// What the server says is wrong.
fn said(answer: &mut Response<Body>) -> anyhow::Error {
    let status = answer.status();
    let mut text = String::new();
    // What could not be read is not shown.
    drop(answer.body_mut().as_reader().take(LONGEST_ERROR).read_to_string(&mut text));
    let body: Value = serde_json::from_str(&text).unwrap_or_default();
    match body["error"].as_str() {
        Some(error) => anyhow::anyhow!("{error}"),
        None => anyhow::anyhow!("the server answered {status}"),
    }
}
