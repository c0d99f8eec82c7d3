//! The time that no step can be faster than: that of reading the weights once.

use std::{hint::black_box, thread};

use super::clock::{quantile, timed};
use crate::model::{ModelDirectory, WeightStorage};

/// Passes over the memory, of which the fastest counts.
const PASSES: usize = 12;
const LANES: usize = 64;

/// Bytes of the GPT's weights as a step reads them.
pub(super) fn weight_bytes(directory: &ModelDirectory) -> usize {
    let manifest = directory.manifest();
    let stored = manifest.files.get("gpt.onnx").map_or(0, |file| file.bytes) as usize;
    match manifest.weights {
        // Widened when loaded.
        WeightStorage::F16 => 2 * stored,
        WeightStorage::F32 | WeightStorage::Int8 => stored,
    }
}

/// Seconds that `threads` threads need to read so many bytes.
pub(super) fn read_seconds(bytes: usize, threads: usize) -> f64 {
    let numbers: Vec<f32> = (0..bytes / size_of::<f32>()).map(|n| n as f32).collect();
    let part = numbers.len().div_ceil(threads.max(1)).max(1);
    let pass = || {
        thread::scope(|scope| {
            for part in numbers.chunks(part).skip(1) {
                scope.spawn(move || black_box(sum(part)));
            }
            black_box(sum(numbers.get(..part).unwrap_or(&numbers)));
        });
    };
    let times = (0..PASSES).map(|_| timed(pass).1).collect();
    quantile(times, 0.0)
}

/// In so many sums side by side that memory is what is waited for.
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
