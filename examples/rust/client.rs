//! A client in Rust with `ureq`: a file in one go, and a dance while it is made.
//!
//! ```text
//! cargo run --example client -- song.mp3 http://127.0.0.1:8080
//! ```

#![expect(clippy::print_stdout, reason = "an example tells what it has done")]

use std::{
    env,
    fs::{self, File},
    io::{BufRead, BufReader},
    time::Instant,
};

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use ureq::{Body, http::Response};

/// An event of the stream: what this program reads of it.
#[derive(Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Event {
    Start { frames: usize, fps: u32 },
    Frames { first: usize, positions: Vec<Vec<[f32; 3]>> },
    Done { tail: String },
    Error { error: String },
}

/// What the server says where it makes no dance.
#[derive(Deserialize)]
struct Refusal {
    error: String,
    request_id: String,
}

fn post(url: &str, accept: &str, song: &str) -> Result<Response<Body>> {
    let body = File::open(song).with_context(|| song.to_owned())?;
    let request = ureq::post(url).header("content-type", "audio/*").header("accept", accept);
    // A status is no error of the transport: the body of a refusal says more than its number.
    let request = request.config().http_status_as_error(false).build();
    let mut answer = request.send(body)?;
    if !answer.status().is_success() {
        let text = answer.body_mut().read_to_string()?;
        let Refusal { error, request_id } = serde_json::from_str(&text)?;
        bail!("{}: {error} (request {request_id})", answer.status());
    }
    Ok(answer)
}

fn main() -> Result<()> {
    let mut arguments = env::args().skip(1);
    let song = arguments.next().context("usage: client SONG [SERVER]")?;
    let server = arguments.next().unwrap_or_else(|| "http://127.0.0.1:8080".into());

    let url = format!("{server}/generate?format=bvh&duration_s=8&seed=7");
    let bvh = post(&url, "*/*", &song)?.into_body().read_to_vec()?;
    fs::write("dance.bvh", &bvh)?;
    println!("dance.bvh: {} bytes", bvh.len());

    let started = Instant::now();
    let url = format!("{server}/generate/stream?duration_s=8&seed=7");
    let answer = post(&url, "application/x-ndjson", &song)?;
    for line in BufReader::new(answer.into_body().into_reader()).lines() {
        let after = started.elapsed().as_secs_f32();
        match serde_json::from_str(&line?)? {
            Event::Start { frames, fps } => println!("{after:.2} s: {frames} frames, {fps} fps"),
            Event::Frames { first, positions } => {
                println!("{after:.2} s: {} frames from {first}", positions.len());
            }
            Event::Done { tail } => println!("{after:.2} s: done, {} letters", tail.len()),
            Event::Error { error } => bail!(error),
        }
    }
    Ok(())
}
