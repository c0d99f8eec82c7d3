//! Steps and prefills of the motion GPT, beside the time of reading its weights.

use ndarray::{Array2, Axis, Slice};

use super::{
    clock::{median, quantile, timed},
    error::Result,
    floor::{read_seconds, weight_bytes},
    report::{StepPoint, ThreadSteps},
};
use crate::model::{Gpt, KvCache, ModelDirectory, ModelError, NextStep, Steps};

const BATCHES: [usize; 5] = [1, 2, 4, 8, 16];
/// Windows that are stepped through.
const WINDOWS: usize = 3;
/// Steps of a prefill as the published hop window has them.
const PREFILL: usize = 15;

pub(super) fn measure(directory: &ModelDirectory, threads: usize) -> Result<ThreadSteps> {
    let manifest = directory.manifest();
    let (context, hop) = (manifest.gpt.context, manifest.sampling.hop);
    let mut gpt = directory.gpt(threads)?;
    let bytes = weight_bytes(directory);
    let song = Song::new(directory);
    let mut cache = gpt.cache(BATCHES.into_iter().max().unwrap_or(1));
    let mut steps = Vec::new();
    for batch in BATCHES {
        let mut times = Vec::new();
        for _ in 0..WINDOWS {
            (0..batch).for_each(|row| cache.clear(row));
            for step in 0..context {
                let next = vec![song.next(step); batch];
                let (logits, seconds) = timed(|| gpt.step(&mut cache, &next));
                logits?;
                times.push(seconds);
            }
        }
        // The mean would count what else the machine did.
        steps.push(StepPoint {
            batch,
            seconds: quantile(times, 0.5),
        });
    }
    let prefill = |steps: usize, gpt: &mut Gpt, cache: &mut KvCache| -> Result<f64, ModelError> {
        median(9, || gpt.prefill(cache, 0, song.first(steps)))
    };
    // The newest of the kept codes goes by a step, like all that follow until the window is full.
    let again = match hop {
        0 | 1 => 0.0,
        hop => prefill(hop - 1, &mut gpt, &mut cache)?,
    };
    let prefilled = prefill(PREFILL.min(context - 1), &mut gpt, &mut cache)?;
    let step = steps.first().map_or(f64::NAN, |point| point.seconds);
    let period = (context - hop + 1) as f64;
    Ok(ThreadSteps {
        threads,
        weight_bytes: bytes,
        floor_s: read_seconds(bytes, threads),
        steps,
        prime_steps: PREFILL.min(context - 1),
        prime_s: prefilled,
        hop,
        code_s: step + again / period,
    })
}

/// Codes and music of no meaning, a window of them.
struct Song {
    codes: Vec<[u32; 2]>,
    music: Array2<f32>,
}

impl Song {
    fn new(directory: &ModelDirectory) -> Self {
        let manifest = directory.manifest();
        let (context, columns) = (manifest.gpt.context, manifest.features.columns);
        let vocabulary = manifest.vocabulary.upper.min(manifest.vocabulary.lower);
        Self {
            codes: (0..context)
                .map(|step| [(step * 7 % vocabulary) as u32; 2])
                .collect(),
            music: Array2::from_shape_fn((context, columns), |(row, column)| {
                ((row * 31 + column * 7) % 97) as f32 / 97.0
            }),
        }
    }

    fn next(&self, step: usize) -> NextStep<'_> {
        NextStep {
            codes: self.codes[step],
            music: self.music.row(step.min(self.music.nrows() - 1)),
        }
    }

    fn first(&self, steps: usize) -> Steps<'_> {
        Steps {
            codes: &self.codes[..steps],
            music: self.music.slice_axis(Axis(0), Slice::from(..steps)),
        }
    }
}
