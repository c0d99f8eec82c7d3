//! Resampling beside the decoder: a thread for every rate.

use std::{
    io, mem, panic,
    sync::{
        Arc,
        mpsc::{SyncSender, sync_channel},
    },
    thread::{Builder, JoinHandle},
};

use crate::resample::Resampler;

/// Samples in a block, about a second: long compared with waking a thread.
const BLOCK: usize = 1 << 15;
/// Blocks that may wait for a resampler before the decoder has to wait.
const WAITING: usize = 2;

/// Resamples a mono signal, which comes in pieces, to several rates.
#[derive(Debug)]
pub(crate) struct Outputs {
    block: Vec<f32>,
    workers: Vec<Worker>,
}

/// A resampler on its thread, which ends with the blocks.
#[derive(Debug)]
struct Worker {
    blocks: SyncSender<Arc<Vec<f32>>>,
    thread: JoinHandle<Vec<f32>>,
}

impl Outputs {
    /// Plans the conversion from one rate to several, in Hz.
    ///
    /// # Errors
    /// The system's, when it starts no thread.
    pub(crate) fn new(from_hz: u32, to_hz: &[u32]) -> io::Result<Self> {
        Self::with_threads(from_hz, to_hz, Builder::new)
    }

    fn with_threads(from_hz: u32, to_hz: &[u32], builder: fn() -> Builder) -> io::Result<Self> {
        let start = |&to| {
            let (blocks, received) = sync_channel::<Arc<Vec<f32>>>(WAITING);
            let thread = builder().spawn(move || {
                let (mut resampler, mut signal) = (Resampler::new(from_hz, to), Vec::new());
                for block in received {
                    resampler.process(&block, &mut signal);
                }
                resampler.finish(&mut signal);
                signal
            })?;
            Ok(Worker { blocks, thread })
        };
        Ok(Self {
            block: Vec::with_capacity(BLOCK),
            workers: to_hz.iter().map(start).collect::<io::Result<_>>()?,
        })
    }

    /// Takes the next samples.
    pub(crate) fn push(&mut self, mut samples: &[f32]) {
        while !samples.is_empty() {
            let room = (BLOCK - self.block.len()).min(samples.len());
            let (first, rest) = samples.split_at(room);
            self.block.extend_from_slice(first);
            samples = rest;
            if self.block.len() == BLOCK {
                self.send_block(Vec::with_capacity(BLOCK));
            }
        }
    }

    fn send_block(&mut self, next: Vec<f32>) {
        let block = Arc::new(mem::replace(&mut self.block, next));
        for worker in &self.workers {
            // Sending fails only after a panic of the thread, which `finish` passes on.
            let _ = worker.blocks.send(Arc::clone(&block));
        }
    }

    /// Ends the signal and returns one per rate, in their order.
    ///
    /// # Panics
    /// With the panic of a resampler.
    pub(crate) fn finish(mut self) -> Vec<Vec<f32>> {
        self.send_block(Vec::new());
        // All channels are closed before the first thread is joined.
        let threads: Vec<_> = self.workers.into_iter().map(|worker| worker.thread).collect();
        let signals = threads.into_iter().map(JoinHandle::join);
        signals
            .map(|signal| signal.unwrap_or_else(|panicked| panic::resume_unwind(panicked)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::resample;

    #[test]
    fn every_rate_is_what_resampling_the_whole_gives() {
        let signal: Vec<f32> = (0..3 * BLOCK + 1_234).map(|i| (i as f32 * 0.01).sin()).collect();
        for piece in [1_152, BLOCK, 5 * BLOCK] {
            let mut outputs = Outputs::new(44_100, &[3_840, 44_100, 30_720]).unwrap();
            signal.chunks(piece).for_each(|part| outputs.push(part));
            let wanted = [3_840, 44_100, 30_720].map(|to| resample(&signal, 44_100, to));
            assert_eq!(outputs.finish(), wanted, "pieces of {piece}");
        }
        let nothing = Outputs::new(8_000, &[3_840]).unwrap().finish();
        assert_eq!(nothing, [Vec::<f32>::new()]);
    }
    #[test]
    fn a_system_without_threads_is_an_error() {
        let builder = || Builder::new().stack_size(1 << 60);
        assert!(Outputs::with_threads(44_100, &[3_840], builder).is_err());
    }
}
