//! Resampling beside the decoder: a thread for every rate that is asked for.

use std::{
    panic,
    sync::{
        Arc,
        mpsc::{SyncSender, sync_channel},
    },
    thread::{self, JoinHandle},
};

use super::Resampler;

/// Samples that are handed over at once, about a second: long beside waking a thread.
const BLOCK: usize = 1 << 15;
/// Blocks that may wait for a resampler; then the decoder does.
const WAITING: usize = 2;

/// Takes a mono signal in pieces, and gives it at each rate.
#[derive(Debug)]
pub(super) struct Outputs {
    block: Vec<f32>,
    resampling: Vec<Resampling>,
}

/// A resampler on its thread, which ends with the blocks.
#[derive(Debug)]
struct Resampling {
    blocks: SyncSender<Arc<[f32]>>,
    thread: JoinHandle<Vec<f32>>,
}

impl Outputs {
    /// Plans the conversion from a rate to each of others, in Hz.
    pub(super) fn new(from_hz: u32, to_hz: &[u32]) -> Self {
        let resampling = to_hz.iter().map(|&to| {
            let (blocks, received) = sync_channel::<Arc<[f32]>>(WAITING);
            let thread = thread::spawn(move || {
                let (mut resampler, mut signal) = (Resampler::new(from_hz, to), Vec::new());
                for block in received {
                    resampler.process(&block, &mut signal);
                }
                resampler.finish(&mut signal);
                signal
            });
            Resampling { blocks, thread }
        });
        Self {
            block: Vec::with_capacity(BLOCK),
            resampling: resampling.collect(),
        }
    }

    /// Takes the next samples.
    pub(super) fn push(&mut self, mut samples: &[f32]) {
        while !samples.is_empty() {
            let room = (BLOCK - self.block.len()).min(samples.len());
            let (first, rest) = samples.split_at(room);
            self.block.extend_from_slice(first);
            samples = rest;
            if self.block.len() == BLOCK {
                self.hand_over();
            }
        }
    }

    fn hand_over(&mut self) {
        let block: Arc<[f32]> = self.block.as_slice().into();
        self.block.clear();
        for resampling in &self.resampling {
            // It fails only where the thread panicked, which `finish` tells.
            let _ = resampling.blocks.send(Arc::clone(&block));
        }
    }

    /// Ends the signal; one for every rate, in their order.
    ///
    /// # Panics
    /// With the panic of a resampler.
    pub(super) fn finish(mut self) -> Vec<Vec<f32>> {
        self.hand_over();
        // All are told that nothing follows before one is waited for.
        let resampling = self.resampling.into_iter();
        let threads: Vec<_> = resampling.map(|resampling| resampling.thread).collect();
        let signals = threads.into_iter().map(JoinHandle::join);
        signals
            .map(|signal| signal.unwrap_or_else(|panicked| panic::resume_unwind(panicked)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample;

    #[test]
    fn every_rate_is_what_resampling_the_whole_gives() {
        let signal: Vec<f32> = (0..3 * BLOCK + 1_234)
            .map(|i| (i as f32 * 0.01).sin())
            .collect();
        for piece in [1_152, BLOCK, 5 * BLOCK] {
            let mut outputs = Outputs::new(44_100, &[3_840, 44_100, 30_720]);
            signal.chunks(piece).for_each(|part| outputs.push(part));
            let wanted = [3_840, 44_100, 30_720].map(|to| resample(&signal, 44_100, to));
            assert_eq!(outputs.finish(), wanted, "pieces of {piece}");
        }
        let nothing = Outputs::new(8_000, &[3_840]).finish();
        assert_eq!(nothing, [Vec::<f32>::new()]);
    }
}
