//! Chunks of codes to motion in world directions, one dance after another's pose or by itself.

use ndarray::{Array2, Axis, Slice};

use super::{chunks::Chunk, error::of_model};
use crate::{CancelToken, Result, formats::Codes, model::Decoder, motion::ToWorld};

/// Frames over which a dance that goes on from another leaves that one's last pose. The decoder did not know
/// what would follow when it made that pose, and does now.
const BLEND_FRAMES: usize = 32;

/// The motion of a dance, as far as it is decoded: its chunks, in order.
#[derive(Debug)]
pub(crate) struct ChunkDecoder {
    /// Codes that come before the dance.
    history: Codes,
    /// Frames so far.
    decoded: usize,
    to_world: ToWorld,
    /// How far the last pose of the dance before lies from the first one, per column.
    seam: Vec<f32>,
    /// How far the root has come on the floor, x and z in metres.
    walked: [f32; 2],
}

impl ChunkDecoder {
    /// Nothing yet of a dance behind the codes of `history`.
    pub(crate) fn new(history: Codes, to_world: ToWorld) -> Self {
        Self {
            history,
            decoded: 0,
            to_world,
            seam: Vec::new(),
            walked: [0.0; 2],
        }
    }

    /// How far the root has come, and where it faces.
    pub(crate) fn end(&self) -> ([f32; 2], f64) {
        (self.walked, self.to_world.heading())
    }

    /// Decodes the next chunk: `[frames, 3 joints]`, in world directions.
    pub(crate) fn decode(
        &mut self,
        chunk: &Chunk,
        decoder: &mut Decoder,
        cancel: &CancelToken,
    ) -> Result<Array2<f32>> {
        let Codes { upper, lower } = &chunk.codes;
        let decoded = decoder.decode(upper, lower, cancel).map_err(of_model)?;
        let per_code = decoded.nrows() / upper.len().max(1);
        let keep = chunk.before * per_code..(chunk.before + chunk.length) * per_code;
        let mut kept = decoded.slice_axis(Axis(0), Slice::from(keep)).to_owned();
        if self.decoded == 0 {
            self.seam = self.seam_to(&kept, decoder, cancel)?;
        }
        self.leave_the_seam(&mut kept);
        let motion = self.to_world.push(kept)?;
        for row in motion.outer_iter() {
            for (walked, column) in self.walked.iter_mut().zip([0, 2]) {
                *walked += row.get(column).copied().unwrap_or_default();
            }
        }
        self.decoded += motion.nrows();
        Ok(motion)
    }

    /// The pose that the dance before ended with, less the first one: the history decoded alone ends as that
    /// dance did.
    fn seam_to(
        &self,
        motion: &Array2<f32>,
        decoder: &mut Decoder,
        cancel: &CancelToken,
    ) -> Result<Vec<f32>> {
        let Codes { upper, lower } = &self.history;
        if upper.is_empty() {
            return Ok(Vec::new());
        }
        let before = decoder.decode(upper, lower, cancel).map_err(of_model)?;
        let (Some(last), Some(first)) =
            (before.outer_iter().next_back(), motion.outer_iter().next())
        else {
            return Ok(Vec::new());
        };
        Ok(last.iter().zip(first).map(|(a, b)| a - b).collect())
    }

    /// Takes the seam back in the frames that follow, with no speed at the end.
    fn leave_the_seam(&self, motion: &mut Array2<f32>) {
        // Groups of three a joint; a turn, which a dancer's frame has behind them, belongs to none.
        let joints = self.seam.len() / 3 * 3;
        let rows = motion.outer_iter_mut().zip(self.decoded..BLEND_FRAMES);
        for (mut row, frame) in rows {
            let part = (frame + 1) as f32 / BLEND_FRAMES as f32;
            let left = (1.0 + 2.0 * part) * (1.0 - part).powi(2);
            let columns = row.iter_mut().zip(&self.seam).take(joints);
            // The root's own columns are its velocity.
            for (value, seam) in columns.skip(3) {
                *value += left * seam;
            }
        }
    }
}
