//! Several at once.

use std::thread;

use ndarray::Array2;

use super::{
    BenchOptions,
    clock::{quantile, timed},
    error::{BenchError, Result},
    report::{LoadPoint, Throughput},
};
use crate::{
    engine::{Engine, GenerationOptions, GenerationRequest},
    formats::Codes,
};

/// Dances at once.
const DANCES: usize = 8;
/// Generations of every caller.
const TURNS: usize = 6;

/// Eight dances at once against one after another, by feature rows: the model alone. Each has a seed
/// and a length of its own, so that their windows move at different steps.
pub(super) fn throughput(engine: &Engine, codes: usize) -> Result<Throughput> {
    let columns = engine.manifest().features.columns;
    let dance = |number: usize| -> Result<Codes> {
        let rows = Array2::from_shape_fn((codes + number, columns), |(row, column)| {
            (((row + number) * 31 + column * 7) % 97) as f32 / 97.0
        });
        let options = GenerationOptions {
            seed: Some(number as u64),
            candidates: Some(1),
            ..GenerationOptions::default()
        };
        let request = GenerationRequest::features(rows, options);
        Ok(engine.generate(request)?.codes)
    };
    dance(0)?;
    let (alone, alone_s) = timed(|| (0..DANCES).map(dance).collect::<Result<Vec<_>>>());
    let (together, together_s) = timed(|| at_once(DANCES, dance));
    let (alone, together) = (alone?, together?);
    Ok(Throughput {
        dances: DANCES,
        codes: alone.iter().map(|codes| codes.upper.len()).sum(),
        one_after_another_s: alone_s,
        at_once_s: together_s,
        same_codes: alone == together,
    })
}

/// Latencies of callers that generate the song again and again at the same time.
pub(super) fn measure(
    engine: &Engine,
    options: &BenchOptions,
    callers: usize,
) -> Result<LoadPoint> {
    let caller = |caller: usize| -> Result<Vec<f64>> {
        let turns = (0..TURNS).map(|turn| {
            let generation = GenerationOptions {
                seed: Some((caller * TURNS + turn) as u64),
                ..GenerationOptions::default()
            };
            let request = GenerationRequest::audio(options.song.clone(), generation);
            let (output, seconds) = timed(|| engine.generate(request));
            output?;
            Ok(seconds)
        });
        turns.collect()
    };
    let (latencies, seconds) = timed(|| at_once(callers, caller));
    let latencies: Vec<f64> = latencies?.into_iter().flatten().collect();
    let at = |share: f64| quantile(latencies.clone(), share);
    Ok(LoadPoint {
        callers,
        dances: latencies.len(),
        dances_per_second: latencies.len() as f64 / seconds,
        p50_s: at(0.5),
        p95_s: at(0.95),
        p99_s: at(0.99),
    })
}

/// `work` with each number below `count`, at the same time.
fn at_once<T: Send>(count: usize, work: impl Fn(usize) -> Result<T> + Sync) -> Result<Vec<T>> {
    let work = &work;
    thread::scope(|scope| {
        let running: Vec<_> = (0..count)
            .map(|number| scope.spawn(move || work(number)))
            .collect();
        running
            .into_iter()
            .map(|one| one.join().unwrap_or(Err(BenchError::Panicked)))
            .collect()
    })
}
