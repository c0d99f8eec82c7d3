//! What scheduling needs of the model: seams that unit tests put fakes into.

use std::{ops::Range, sync::Arc};

use ndarray::{Array2, Array3, Axis};
use parking_lot::{Mutex, MutexGuard};

use crate::model::{Decoder, Gpt, KvCache, Logits, ModelError, NextStep, Steps};

/// A model of code sequences that are computed side by side, a row of its cache each.
pub(crate) trait CodeModel: Send {
    /// Sequences that fit side by side.
    fn rows(&self) -> usize;

    /// Empties a row.
    fn clear(&mut self, row: usize);

    /// Copies rows to those from `to` on; all of them exist.
    fn copy(&mut self, from: Range<usize>, to: usize);

    /// Makes a row hold `steps` and nothing else.
    ///
    /// # Errors
    /// As [`Gpt::prefill`]. The row is empty then.
    fn prefill(&mut self, row: usize, steps: Steps<'_>) -> Result<(), ModelError>;

    /// Computes one more step of the sequences in the first rows, which then hold it as well, and
    /// returns the logits that follow.
    ///
    /// # Errors
    /// As [`Gpt::step`]. The rows are unchanged then.
    fn step(&mut self, next: &[NextStep<'_>]) -> Result<Logits, ModelError>;
}

/// The motion GPT with its cache.
pub(crate) struct CachedGpt {
    gpt: Gpt,
    cache: KvCache,
}

impl CachedGpt {
    pub(crate) fn new(gpt: Gpt, rows: usize) -> Self {
        let cache = gpt.cache(rows);
        Self { gpt, cache }
    }
}

impl CodeModel for CachedGpt {
    fn rows(&self) -> usize {
        self.cache.rows()
    }

    fn clear(&mut self, row: usize) {
        self.cache.clear(row);
    }

    fn copy(&mut self, from: Range<usize>, to: usize) {
        self.cache.copy(from, to);
    }

    fn prefill(&mut self, row: usize, steps: Steps<'_>) -> Result<(), ModelError> {
        self.gpt.prefill(&mut self.cache, row, steps)
    }

    fn step(&mut self, next: &[NextStep<'_>]) -> Result<Logits, ModelError> {
        self.gpt.step(&mut self.cache, next)
    }
}

/// A decoder of code sequences to motion.
pub(crate) trait MotionDecoder: Send {
    /// Decodes sequences of one length, to `[sequences, frames, columns]`.
    ///
    /// # Errors
    /// As [`Decoder::decode_batch`].
    fn decode_batch(&mut self, sequences: &[&[[u32; 2]]]) -> Result<Array3<f32>, ModelError>;

    /// Decodes one sequence, to `[frames, columns]`.
    ///
    /// # Errors
    /// As [`Decoder::decode`].
    fn decode(&mut self, codes: &[[u32; 2]]) -> Result<Array2<f32>, ModelError> {
        let motion = self.decode_batch(&[codes])?;
        Ok(motion.index_axis_move(Axis(0), 0))
    }
}

impl MotionDecoder for Decoder {
    fn decode_batch(&mut self, sequences: &[&[[u32; 2]]]) -> Result<Array3<f32>, ModelError> {
        self.decode_batch(sequences)
    }
}

/// The decoder, which one thread at a time uses. The lock is a fair one: the scorer waits for the
/// chunk that is being decoded, not for all that wait after it.
#[derive(Clone)]
pub(crate) struct SharedDecoder(Arc<Mutex<dyn MotionDecoder>>);

impl SharedDecoder {
    pub(crate) fn new(decoder: impl MotionDecoder + 'static) -> Self {
        Self(Arc::new(Mutex::new(decoder)))
    }

    /// Waits for it. A panic leaves nothing half done in it: it keeps nothing between runs.
    pub(crate) fn lock(&self) -> MutexGuard<'_, dyn MotionDecoder + 'static> {
        self.0.lock()
    }
}
