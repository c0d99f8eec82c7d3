//! How fast a model and this machine are: what `bailando bench` prints. Nothing here is asserted in
//! tests; figures are medians of wall-clock times of one run on a machine that should do nothing else.

mod baseline;
mod clock;
mod decoder;
mod error;
mod floor;
mod length;
mod load;
mod machine;
mod plot;
mod report;
mod stages;
mod steps;

pub use baseline::Baseline;
pub use error::BenchError;
pub use report::{
    Bench, LengthPoint, LoadPoint, Machine, Stage, StepPoint, ThreadSteps, Throughput,
};

use std::path::PathBuf;

use bytes::Bytes;

use self::error::Result;
use crate::{
    engine::{Engine, EngineConfig},
    model::ModelDirectory,
};

/// What to measure, on what.
#[derive(Clone, Debug)]
pub struct BenchOptions {
    /// The model directory.
    pub model_dir: PathBuf,
    /// The song, as uploaded.
    pub song: Bytes,
    /// Numbers of threads that steps are measured with; the last one's serve all else.
    pub threads: Vec<usize>,
    /// Repetitions of each stage, of which the median counts.
    pub repeats: usize,
    /// Lengths in seconds that the song is repeated to.
    pub lengths_s: Vec<f64>,
    /// Numbers of callers that generate the song at the same time.
    pub callers: Vec<usize>,
    /// Codes of each dance in the comparison of eight at once with one after another.
    pub batch_codes: usize,
}

/// Measures all of it; `say` hears what comes next.
///
/// # Errors
/// Whatever a generation may fail with.
pub fn run(options: &BenchOptions, say: &dyn Fn(&str)) -> Result<Bench> {
    let directory = ModelDirectory::open(&options.model_dir)?;
    let threads = options.threads.last().copied().unwrap_or(1);
    say("start");
    let memory_before = machine::resident_bytes();
    let config = EngineConfig {
        threads,
        queue: 64,
        ..EngineConfig::new(&options.model_dir)
    };
    let (engine, start_s) = clock::timed(|| Engine::open(&config));
    let engine = engine?;
    let idle = machine::resident_bytes();
    say("stages");
    let mut stages = stages::measure(&engine, options, threads)?;
    for &threads in &options.threads {
        stages.push(decoder::measure(&directory, options.repeats, threads)?);
    }
    let mut steps = Vec::new();
    for &threads in &options.threads {
        say(&format!("steps with {threads} threads"));
        steps.push(steps::measure(&directory, threads)?);
    }
    say("eight at once");
    let throughput = load::throughput(&engine, options.batch_codes)?;
    let mut load = Vec::new();
    for &callers in &options.callers {
        say(&format!("{callers} callers"));
        load.push(load::measure(&engine, options, callers)?);
    }
    let mut lengths = Vec::new();
    for &seconds in &options.lengths_s {
        say(&format!("a song of {seconds} s"));
        lengths.push(length::measure(&engine, &options.song, seconds)?);
    }
    Ok(Bench {
        machine: machine::describe(),
        model: directory.manifest().name.clone(),
        weights: directory.manifest().weights,
        threads,
        start_s,
        resident_before_start_bytes: memory_before,
        resident_idle_bytes: idle,
        resident_peak_bytes: machine::peak_bytes(),
        stages,
        steps,
        throughput,
        load,
        lengths,
    })
}
