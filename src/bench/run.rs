//! All measurements of a bench, in order.

use super::{
    clock::timed, error::Result, generator::Generator, length, load, machine,
    options::BenchOptions, report::Bench, stages, steps,
};
use crate::model::ModelDirectory;

/// Measures everything; `report` is called with the name of each part before it begins.
///
/// # Errors
/// Any error of a generation.
pub fn run(options: &BenchOptions, report: &dyn Fn(&str)) -> Result<Bench> {
    let directory = ModelDirectory::open(&options.model_dir)?.on(options.device);
    let manifest = directory.manifest();
    let threads = options.threads.last().copied().unwrap_or(1);
    report("start");
    let resident_before_start_bytes = machine::resident_bytes();
    let (generator, start_s) = timed(|| Generator::open(options, threads));
    let generator = generator?;
    let resident_idle_bytes = machine::resident_bytes();
    report("stages");
    let mut stages = stages::measure(&generator, options, threads)?;
    for &threads in &options.threads {
        stages.push(stages::decoder(&directory, options.repeats, threads)?);
    }
    let steps = options.threads.iter().map(|&threads| {
        report(&format!("steps with {threads} threads"));
        steps::measure(&directory, threads)
    });
    let steps = steps.collect::<Result<_>>()?;
    report("eight at once");
    let throughput = load::throughput(&generator, manifest, options.batch_codes)?;
    let load = options.callers.iter().map(|&callers| {
        report(&format!("{callers} callers"));
        load::measure(&generator, callers)
    });
    let load = load.collect::<Result<_>>()?;
    let lengths = options.lengths_s.iter().map(|&seconds| {
        report(&format!("a song of {seconds} s"));
        length::measure(&generator, seconds)
    });
    let lengths = lengths.collect::<Result<_>>()?;
    Ok(Bench {
        machine: machine::describe(),
        model: manifest.name.clone(),
        weights: manifest.weights,
        device: options.device.to_string(),
        threads,
        start_s,
        resident_before_start_bytes,
        resident_idle_bytes,
        resident_peak_bytes: machine::peak_bytes(),
        stages,
        steps,
        throughput,
        load,
        lengths,
    })
}
