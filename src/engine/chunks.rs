//! Pose codes to motion in overlapping chunks: the same as at once, with bounded memory and while later
//! codes are still unknown.

use ndarray::{Array2, Axis, Slice};

use super::error::of_model;
use crate::{
    CancelToken, Result,
    format::Codes,
    model::{Decoder, Manifest},
    motion::ToWorld,
};

/// Codes decoded per chunk besides the overlap, which is a sixth of the work then; memory does not grow
/// with the song, and one of half a minute is a single chunk.
pub(crate) const CHUNK_CODES: usize = 256;
/// Codes of the first chunk where somebody waits for it, a little more than the floor's lookahead; each further one is
/// twice as long.
const FIRST_CHUNK: usize = 24;
/// Frames over which a dance that goes on from another leaves that one's last pose. The decoder did not know
/// what would follow when it made that pose, and does now.
const BLEND_FRAMES: usize = 32;

/// The motion of a piece, as far as it is decoded.
///
/// The manifest's `receptive_codes` on either side of a chunk are decoded with it and dropped again; only the
/// piece's own ends see the zero padding (ARCHITECTURE section 2).
#[derive(Debug)]
pub(crate) struct Chunks {
    /// Codes that come before the piece: they are decoded with it, so that it goes on from them.
    history: Codes,
    /// Codes of the whole piece, and of those decoded.
    total: usize,
    decoded: usize,
    /// Codes of the next chunk.
    size: usize,
    to_world: ToWorld,
    /// How far the last pose of the dance before lies from the first one, per column.
    seam: Vec<f32>,
    /// How far the root has come on the floor, x and z in metres.
    walked: [f32; 2],
}

impl Chunks {
    /// Nothing yet of a piece of `total` codes behind those of `history`.
    pub(crate) fn new(total: usize, history: Codes, to_world: ToWorld) -> Self {
        Self {
            history,
            total,
            decoded: 0,
            size: CHUNK_CODES,
            to_world,
            seam: Vec::new(),
            walked: [0.0; 2],
        }
    }

    /// With small chunks first, so that the first frames come soon.
    pub(crate) fn soon(self) -> Self {
        self.starting_with(FIRST_CHUNK)
    }

    /// With a first chunk of `size` codes.
    pub(crate) fn starting_with(self, size: usize) -> Self {
        Self { size, ..self }
    }

    /// Whether everything is decoded.
    pub(crate) fn is_complete(&self) -> bool {
        self.decoded >= self.total
    }

    /// Where the root has come to, and where it faces.
    pub(crate) fn end(&self) -> ([f32; 2], f64) {
        (self.walked, self.to_world.facing())
    }

    /// Decodes the next chunk `[frames, 3 joints]`, in world directions, if `codes` (upper and lower) know it
    /// and what follows it as far as it matters.
    pub(crate) fn advance(
        &mut self,
        decoder: &mut Decoder,
        codes: [&[u32]; 2],
        manifest: &Manifest,
        cancel: &CancelToken,
    ) -> Result<Option<Array2<f32>>> {
        let (receptive, per_code) = (manifest.decoder.receptive_codes, manifest.frames_per_code);
        let to = (self.decoded + self.size).min(self.total);
        let end = (to + receptive).min(self.total);
        let known = codes.iter().all(|half| half.len() >= end);
        if self.is_complete() || !known {
            return Ok(None);
        }
        // From here on counted from the first code of the history.
        let before = self.history.upper.len();
        let from = before + self.decoded;
        let first = from.saturating_sub(receptive);
        let [upper, lower] = codes;
        let part = |history: &[u32], half: &[u32]| -> Vec<u32> {
            let all = history.iter().chain(half);
            let part = all.take(before + end).skip(first);
            part.copied().collect()
        };
        let upper = part(&self.history.upper, upper);
        let lower = part(&self.history.lower, lower);
        let decoded = decoder.decode(&upper, &lower, cancel).map_err(of_model)?;
        let keep = Slice::from((from - first) * per_code..(before + to - first) * per_code);
        let mut kept = decoded.slice_axis(Axis(0), keep).to_owned();
        if self.decoded == 0 {
            self.seam = self.seam_to(&kept, decoder, cancel)?;
        }
        self.leave_the_seam(&mut kept, self.decoded * per_code);
        let motion = self.to_world.push(kept)?;
        for row in motion.outer_iter() {
            for (walked, column) in self.walked.iter_mut().zip([0, 2]) {
                *walked += row.get(column).copied().unwrap_or_default();
            }
        }
        self.decoded = to;
        self.size = (2 * self.size).min(CHUNK_CODES);
        Ok(Some(motion))
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

    /// Takes the seam back in the frames from `first` on, with no speed at the end.
    fn leave_the_seam(&self, motion: &mut Array2<f32>, first: usize) {
        // Groups of three a joint; a turn, which a dancer's frame has behind them, belongs to none.
        let joints = self.seam.len() / 3 * 3;
        let rows = motion.outer_iter_mut().zip(first..BLEND_FRAMES);
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
