//! The generation loop of one request: music rows in, pose codes out, codes to motion.

use ndarray::{Array2, ArrayView2, Axis, Slice};

use super::{
    progress::Progress,
    sampler::Sampler,
    window::{Window, WindowStep},
};
use crate::{
    CancelToken,
    format::Codes,
    model::{Decoder, Gpt, ModelError, Steps},
};

/// Codes decoded per chunk besides the overlap: two shapes at most are decoded per song.
const CHUNK_CODES: usize = 64;

/// Generates one code pair per row of `music` `[rows, columns]`, beginning with `start`.
///
/// The row beside code `k` is `k + 1`: the reference drops the first row.
pub(crate) fn generate_codes(
    gpt: &mut Gpt,
    music: ArrayView2<'_, f32>,
    start: [u32; 2],
    window: Window,
    sampler: &mut Sampler,
    progress: &dyn Progress,
    cancel: &CancelToken,
) -> Result<Codes, ModelError> {
    let rows = music.nrows();
    let mut codes = Codes {
        upper: vec![start[0]],
        lower: vec![start[1]],
    };
    let mut cache = gpt.empty_cache()?;
    for step in 0..rows.saturating_sub(1) {
        if cancel.is_cancelled() {
            return Err(ModelError::Cancelled);
        }
        let first = match window.at(step) {
            WindowStep::Extend => step,
            WindowStep::Prime { start } => {
                cache = gpt.empty_cache()?;
                start
            }
        };
        let steps = Steps {
            upper: codes.upper.get(first..).unwrap_or_default(),
            lower: codes.lower.get(first..).unwrap_or_default(),
            music: music.slice_axis(Axis(0), Slice::from(first + 1..step + 2)),
        };
        let logits = gpt.run(steps, &mut cache, cancel)?;
        // Upper first: one generator per request serves both halves in this order.
        let newest = |logits: &Array2<f32>| logits.nrows().saturating_sub(1);
        let upper = sampler.next(logits.upper.row(newest(&logits.upper)).iter().copied());
        let lower = sampler.next(logits.lower.row(newest(&logits.lower)).iter().copied());
        codes.upper.push(upper as u32);
        codes.lower.push(lower as u32);
        progress.codes(step + 2, rows);
    }
    Ok(codes)
}

/// Decodes a whole piece in overlapping chunks: the same as at once, with bounded memory.
///
/// `receptive` codes on either side of a chunk are decoded with it and dropped again; only the
/// piece's own ends see the zero padding (ARCHITECTURE section 2).
pub(crate) fn decode_codes(
    decoder: &mut Decoder,
    codes: &Codes,
    receptive: usize,
    frames_per_code: usize,
    cancel: &CancelToken,
) -> Result<Array2<f32>, ModelError> {
    let total = codes.upper.len();
    let mut motion: Option<Array2<f32>> = None;
    let mut from = 0;
    while from < total {
        let to = (from + CHUNK_CODES).min(total);
        let first = from.saturating_sub(receptive);
        let last = (to + receptive).min(total);
        let upper = codes.upper.get(first..last).unwrap_or_default();
        let lower = codes.lower.get(first..last).unwrap_or_default();
        let decoded = decoder.decode(upper, lower, cancel)?;
        let keep = Slice::from((from - first) * frames_per_code..(to - first) * frames_per_code);
        let part = decoded.slice_axis(Axis(0), keep);
        let motion =
            motion.get_or_insert_with(|| Array2::zeros((total * frames_per_code, part.ncols())));
        let place = Slice::from(from * frames_per_code..to * frames_per_code);
        motion.slice_axis_mut(Axis(0), place).assign(&part);
        from = to;
    }
    motion.ok_or_else(|| ModelError::Input {
        what: "pose codes",
        expected: "at least one pair".into(),
        got: "none".into(),
    })
}
