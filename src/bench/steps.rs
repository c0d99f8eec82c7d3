//! Steps and prefills of the motion GPT, beside the time that no step can beat: that of reading its
//! weights once.

use std::{hint::black_box, thread};

use ndarray::{Array2, Axis, Slice};

use super::{
    clock::{median, quantile, timed},
    error::Result,
    report::{StepPoint, ThreadSteps},
};
use crate::model::{ModelDirectory, ModelError, NextStep, Steps, WeightStorage};

const BATCHES: [usize; 5] = [1, 2, 4, 8, 16];
/// Windows that are generated, a step at a time.
const WINDOWS: usize = 3;
/// Steps of a prefill in the published hop window.
const PREFILL: usize = 15;
/// Passes over the memory, of which the fastest counts.
const PASSES: usize = 12;
/// Sums side by side, so many that a pass waits for the memory.
const LANES: usize = 64;

pub(super) fn measure(directory: &ModelDirectory, threads: usize) -> Result<ThreadSteps> {
    let manifest = directory.manifest();
    let (context, hop) = (manifest.gpt.context, manifest.sampling.hop);
    let mut gpt = directory.gpt(threads)?;
    let window = Window::new(directory);
    let mut cache = gpt.cache(BATCHES.into_iter().max().unwrap_or(1));
    let mut steps = Vec::new();
    for batch in BATCHES {
        let mut times = Vec::new();
        for _ in 0..WINDOWS {
            (0..batch).for_each(|row| cache.clear(row));
            for step in 0..context {
                let next = vec![window.next(step); batch];
                let (logits, seconds) = timed(|| gpt.step(&mut cache, &next));
                logits?;
                times.push(seconds);
            }
        }
        // A mean would include the other work of the machine.
        let seconds = quantile(times, 0.5);
        steps.push(StepPoint { batch, seconds });
    }
    let mut prefill = |steps: usize| -> Result<f64, ModelError> {
        median(9, || gpt.prefill(&mut cache, 0, window.first(steps)))
    };
    // The newest of the kept codes is a step, like all that follow until the window is full.
    let again = match hop {
        0 | 1 => 0.0,
        hop => prefill(hop - 1)?,
    };
    let prefill_steps = PREFILL.min(context - 1);
    let weight_bytes = weight_bytes(directory);
    Ok(ThreadSteps {
        threads,
        weight_bytes,
        floor_s: read_seconds(weight_bytes, threads),
        prefill_steps,
        prefill_s: prefill(prefill_steps)?,
        hop,
        code_s: steps[0].seconds + again / (context - hop + 1) as f64,
        steps,
    })
}

/// A window of codes and music without meaning.
struct Window {
    codes: Vec<[u32; 2]>,
    music: Array2<f32>,
}

impl Window {
    fn new(directory: &ModelDirectory) -> Self {
        let manifest = directory.manifest();
        let context = manifest.gpt.context;
        let vocabulary = manifest.vocabulary.upper.min(manifest.vocabulary.lower);
        let pair = |step: usize| [(step * 7 % vocabulary) as u32; 2];
        Self {
            codes: (0..context).map(pair).collect(),
            music: noise(context, manifest.conditioning_columns(), 0),
        }
    }

    fn next(&self, step: usize) -> NextStep<'_> {
        NextStep { codes: self.codes[step], music: self.music.row(step) }
    }

    fn first(&self, steps: usize) -> Steps<'_> {
        Steps {
            codes: &self.codes[..steps],
            music: self.music.slice_axis(Axis(0), Slice::from(..steps)),
        }
    }
}

/// Feature rows without meaning, the same for the same number.
pub(super) fn noise(rows: usize, columns: usize, number: usize) -> Array2<f32> {
    Array2::from_shape_fn((rows, columns), |(row, column)| {
        (((row + number) * 31 + column * 7) % 97) as f32 / 97.0
    })
}

/// Returns the bytes of the GPT's weights as a step reads them.
fn weight_bytes(directory: &ModelDirectory) -> usize {
    let manifest = directory.manifest();
    let stored = manifest.files.get("gpt.onnx").map_or(0, |file| file.bytes) as usize;
    match manifest.weights {
        // Widened when loaded.
        WeightStorage::F16 => 2 * stored,
        WeightStorage::F32 | WeightStorage::Int8 => stored,
    }
}

/// Measures the seconds that `threads` threads need to read so many bytes.
fn read_seconds(bytes: usize, threads: usize) -> f64 {
    let numbers: Vec<f32> = (0..bytes / size_of::<f32>()).map(|n| n as f32).collect();
    let part = numbers.len().div_ceil(threads.max(1)).max(1);
    let pass = || {
        thread::scope(|scope| {
            for part in numbers.chunks(part).skip(1) {
                scope.spawn(move || black_box(sum(part)));
            }
            black_box(sum(&numbers[..part.min(numbers.len())]));
        });
    };
    let times = (0..PASSES).map(|_| timed(pass).1).collect();
    quantile(times, 0.0)
}

fn sum(numbers: &[f32]) -> f32 {
    let (chunks, rest) = numbers.as_chunks::<LANES>();
    let mut sums = [0.0_f32; LANES];
    for chunk in chunks {
        for (sum, number) in sums.iter_mut().zip(chunk) {
            *sum += number;
        }
    }
    sums.iter().sum::<f32>() + rest.iter().sum::<f32>()
}
