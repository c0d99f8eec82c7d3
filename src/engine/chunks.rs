//! Pose codes to motion in overlapping chunks: the same as at once, with bounded memory and while later
//! codes are still unknown.

use ndarray::{Array2, Axis, Slice};

use crate::{
    CancelToken,
    format::Codes,
    model::{Decoder, Manifest, ModelError},
};

/// Codes decoded per chunk besides the overlap, which is a third of the work then; memory does not grow
/// with the song.
pub(crate) const CHUNK_CODES: usize = 128;

/// The motion of a piece, as far as it is decoded; in the manifest's frame: a dancer's turns cannot be
/// summed before chunks are joined.
///
/// The manifest's `receptive_codes` on either side of a chunk are decoded with it and dropped again; only the
/// piece's own ends see the zero padding (ARCHITECTURE section 2).
#[derive(Debug)]
pub(crate) struct Chunks {
    /// Codes of the whole piece.
    total: usize,
    /// Codes that are decoded.
    decoded: usize,
    motion: Array2<f32>,
}

impl Chunks {
    /// Nothing of a piece of `total` codes yet.
    pub(crate) fn new(total: usize, manifest: &Manifest) -> Self {
        let shape = (total * manifest.frames_per_code, manifest.decoded_columns());
        Self {
            total,
            decoded: 0,
            motion: Array2::zeros(shape),
        }
    }

    /// Whether everything is decoded.
    pub(crate) fn is_complete(&self) -> bool {
        self.decoded >= self.total
    }

    /// Decodes the next chunk, if `codes` know it and what follows it as far as it matters.
    pub(crate) fn advance(
        &mut self,
        decoder: &mut Decoder,
        codes: &Codes,
        manifest: &Manifest,
        cancel: &CancelToken,
    ) -> Result<bool, ModelError> {
        let (receptive, per_code) = (manifest.decoder.receptive_codes, manifest.frames_per_code);
        let from = self.decoded;
        let to = (from + CHUNK_CODES).min(self.total);
        let (first, last) = (
            from.saturating_sub(receptive),
            (to + receptive).min(self.total),
        );
        let known = [&codes.upper, &codes.lower].map(|half| half.get(first..last));
        let [Some(upper), Some(lower)] = known else {
            return Ok(false);
        };
        if self.is_complete() {
            return Ok(false);
        }
        let decoded = decoder.decode(upper, lower, cancel)?;
        let keep = Slice::from((from - first) * per_code..(to - first) * per_code);
        let place = Slice::from(from * per_code..to * per_code);
        self.motion
            .slice_axis_mut(Axis(0), place)
            .assign(&decoded.slice_axis(Axis(0), keep));
        self.decoded = to;
        Ok(true)
    }

    /// The motion, `[frames, columns]`.
    pub(crate) fn into_motion(self) -> Array2<f32> {
        self.motion
    }
}
