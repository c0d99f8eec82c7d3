//! Chunks of codes to motion in world directions, continuing the pose before them.

use ndarray::{Array2, Axis, Slice};

use super::{EngineError, chunks::Chunk, code_model::MotionDecoder};
use crate::motion::ToWorld;

/// Frames over which a motion that continues another blends out that one's last pose. The decoder
/// did not know what would follow when it made that pose, and does now.
const BLEND_FRAMES: usize = 32;

/// The motion of a sequence, as far as it is decoded: its chunks, in order.
#[derive(Debug)]
pub(crate) struct ChunkDecoder {
    /// Codes of the motion that this one continues.
    prompt: Vec<[u32; 2]>,
    /// Frames of the prompt's last code that were shown before, where the first chunk begins with
    /// that code.
    shown: usize,
    /// Frames that are wanted; all if none.
    length: Option<usize>,
    /// Frames so far.
    decoded: usize,
    to_world: ToWorld,
    /// The prompt's last pose less this motion's first one, per column.
    offset: Vec<f32>,
    /// How far the root has come on the floor, x and z in metres.
    walked: [f32; 2],
}

impl ChunkDecoder {
    /// Before the first chunk after the codes of `prompt`.
    pub(crate) fn new(prompt: Vec<[u32; 2]>, to_world: ToWorld) -> Self {
        Self {
            prompt,
            shown: 0,
            length: None,
            decoded: 0,
            to_world,
            offset: Vec::new(),
            walked: [0.0; 2],
        }
    }

    /// With a first chunk that begins with the prompt's last code, of which `shown` frames were
    /// shown before; of no code if that is zero.
    pub(crate) fn resuming(self, shown: usize) -> Self {
        Self { shown, ..self }
    }

    /// Ends after `length` frames: what the codes give beyond is cut.
    pub(crate) fn ending_after(self, length: Option<usize>) -> Self {
        Self { length, ..self }
    }

    /// Frames so far.
    pub(crate) fn frames(&self) -> usize {
        self.decoded
    }

    /// How far the root has come, x and z in metres, and its heading in radians.
    pub(crate) fn end(&self) -> ([f32; 2], f64) {
        (self.walked, self.to_world.heading())
    }

    /// Decodes the next chunk: `[frames, 3 joints]`, in world directions.
    pub(crate) fn decode(
        &mut self,
        chunk: &Chunk,
        decoder: &mut dyn MotionDecoder,
    ) -> Result<Array2<f32>, EngineError> {
        let mut kept = decoder.decode(&chunk.codes)?;
        let per_code = kept.nrows() / chunk.codes.len().max(1);
        let is_first = self.decoded == 0;
        let first = chunk.before * per_code + if is_first { self.shown } else { 0 };
        let wanted = self.length.map_or(usize::MAX, |length| length - self.decoded);
        let end = ((chunk.before + chunk.length) * per_code).min(first.saturating_add(wanted));
        kept.slice_axis_inplace(Axis(0), Slice::from(first..end));
        if is_first && !self.prompt.is_empty() && kept.nrows() > 0 {
            self.offset = self.offset_to(&kept, per_code, decoder)?;
        }
        self.blend(&mut kept);
        let motion = self.to_world.push(kept)?;
        for row in motion.outer_iter() {
            for (walked, column) in self.walked.iter_mut().zip([0, 2]) {
                *walked += row[column];
            }
        }
        self.decoded += motion.nrows();
        Ok(motion)
    }

    /// The last pose shown of the prompt less the first one of `motion`: the prompt decoded alone
    /// ends as the earlier motion did.
    fn offset_to(
        &self,
        motion: &Array2<f32>,
        per_code: usize,
        decoder: &mut dyn MotionDecoder,
    ) -> Result<Vec<f32>, EngineError> {
        let before = decoder.decode(&self.prompt)?;
        let unshown = if self.shown == 0 { 0 } else { per_code - self.shown };
        let last = before.row(before.nrows() - 1 - unshown);
        let pairs = last.iter().zip(motion.row(0));
        Ok(pairs.map(|(last, first)| last - first).collect())
    }

    /// Blends the offset out over the first frames, with no speed at the end.
    fn blend(&self, motion: &mut Array2<f32>) {
        // Groups of three a joint; the turn that follows them in a dancer's frame belongs to none.
        let joints = self.offset.len() / 3 * 3;
        let rows = motion.outer_iter_mut().zip(self.decoded..BLEND_FRAMES);
        for (mut row, frame) in rows {
            let part = (frame + 1) as f32 / BLEND_FRAMES as f32;
            let left = (1.0 + 2.0 * part) * (1.0 - part).powi(2);
            let columns = row.iter_mut().zip(&self.offset).take(joints);
            // The root's own columns are its velocity.
            for (value, offset) in columns.skip(3) {
                *value += left * offset;
            }
        }
    }
}
