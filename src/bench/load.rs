//! Several generations at once.

use std::thread;

use super::{
    clock::{quantile, timed},
    error::{BenchError, Result},
    generator::Generator,
    report::{LoadPoint, Throughput},
    steps::noise,
};
use crate::{formats::Codes, model::Manifest};

/// Motions at once.
const MOTIONS: usize = 8;
/// Generations of every caller.
const TURNS: usize = 6;

/// Compares eight generations at once with one after another, by feature rows: the model alone.
/// Each has a seed and a length of its own, so that their windows move at different steps.
pub(super) fn throughput(
    generator: &Generator,
    manifest: &Manifest,
    codes: usize,
) -> Result<Throughput> {
    let generate = |number: usize| -> Result<Codes> {
        let rows = noise(codes + number, manifest.features.columns, number);
        generator.rows(rows, number as u64)
    };
    generate(0)?;
    let (alone, alone_s) = timed(|| (0..MOTIONS).map(generate).collect::<Result<Vec<_>>>());
    let (together, together_s) = timed(|| at_once(MOTIONS, generate));
    let (alone, together) = (alone?, together?);
    Ok(Throughput {
        dances: MOTIONS,
        codes: alone.iter().map(|codes| codes.upper.len()).sum(),
        one_after_another_s: alone_s,
        at_once_s: together_s,
        same_codes: alone == together,
    })
}

/// Measures the latencies of callers that generate to the song repeatedly at the same time.
pub(super) fn measure(generator: &Generator, callers: usize) -> Result<LoadPoint> {
    let caller = |caller: usize| -> Result<Vec<f64>> {
        let turns = (0..TURNS).map(|turn| {
            let seed = (caller * TURNS + turn) as u64;
            let (dance, seconds) = timed(|| generator.song(seed, None));
            dance.map(|_| seconds)
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

/// Calls `work` with each number below `count`, at the same time.
fn at_once<T: Send>(count: usize, work: impl Fn(usize) -> Result<T> + Sync) -> Result<Vec<T>> {
    let work = &work;
    thread::scope(|scope| {
        let spawn = |number| scope.spawn(move || work(number));
        let running: Vec<_> = (0..count).map(spawn).collect();
        let ended = running.into_iter().map(|one| one.join());
        ended.map(|result| result.unwrap_or_else(|_| Err(BenchError::Panicked))).collect()
    })
}
