//! The generation loop of one request: music rows in, pose codes out, codes to motion.

use std::rc::Rc;

use ndarray::{Array2, ArrayView2, Axis, Slice};

use super::{
    guidance::Guide,
    progress::Progress,
    sampler::Sampler,
    window::{Window, WindowStep},
};
use crate::{
    CancelToken,
    format::Codes,
    model::{Decoder, Gpt, KvCache, Manifest, ModelError, Steps},
};

/// Codes decoded per chunk besides the overlap: two shapes at most are decoded per song.
pub(crate) const CHUNK_CODES: usize = 64;

/// What one request's loop runs on.
pub(crate) struct Request<'a> {
    /// Music rows `[rows, columns]`.
    pub(crate) music: ArrayView2<'a, f32>,
    /// How strongly the music's time is followed; none: as the model says.
    pub(crate) guide: Option<&'a Guide>,
    /// The first code pair, upper and lower.
    pub(crate) start: [u32; 2],
    /// How the window of past codes moves.
    pub(crate) window: Window,
    /// Hears how many codes there are.
    pub(crate) progress: &'a dyn Progress,
    /// Checked at every step.
    pub(crate) cancel: &'a CancelToken,
}

/// Generates one code pair per music row, beginning with the start pair.
pub(crate) fn generate_codes(
    gpt: &mut Gpt,
    sampler: &mut Sampler,
    request: &Request<'_>,
) -> Result<Codes, ModelError> {
    let rows = request.music.nrows();
    let mut dance = Dancing::new(gpt, request)?;
    while dance.codes.upper.len() < rows {
        dance.step(gpt, sampler, request)?;
        request.progress.codes(dance.codes.upper.len(), rows);
    }
    Ok(dance.codes)
}

/// A dance so far. Clones share what the GPT remembers and go on by themselves.
#[derive(Clone)]
pub(crate) struct Dancing {
    pub(crate) codes: Codes,
    heard: Rc<KvCache>,
    unheard: Rc<KvCache>,
}

impl Dancing {
    /// The start pair alone.
    pub(crate) fn new(gpt: &Gpt, request: &Request<'_>) -> Result<Self, ModelError> {
        let [upper, lower] = request.start;
        Ok(Self {
            codes: Codes {
                upper: vec![upper],
                lower: vec![lower],
            },
            heard: Rc::new(gpt.empty_cache()?),
            unheard: Rc::new(gpt.empty_cache()?),
        })
    }

    /// One more code pair.
    pub(crate) fn step(
        &mut self,
        gpt: &mut Gpt,
        sampler: &mut Sampler,
        request: &Request<'_>,
    ) -> Result<(), ModelError> {
        if request.cancel.is_cancelled() {
            return Err(ModelError::Cancelled);
        }
        let step = self.codes.upper.len() - 1;
        let first = match request.window.at(step) {
            WindowStep::Extend => step,
            WindowStep::Prime { start } => {
                self.heard = Rc::new(gpt.empty_cache()?);
                if request.guide.is_some() {
                    self.unheard = Rc::new(gpt.empty_cache()?);
                }
                start
            }
        };
        let heard = steps_from(first, &self.codes, request.music);
        let (mut logits, cache) = gpt.run_after(heard, &self.heard, request.cancel)?;
        self.heard = Rc::new(cache);
        if let Some(guide) = request.guide {
            let unheard = steps_from(first, &self.codes, guide.timeless());
            let (deaf, cache) = gpt.run_after(unheard, &self.unheard, request.cancel)?;
            self.unheard = Rc::new(cache);
            guide.lead(&mut logits, &deaf);
        }
        // Upper first: one generator per request serves both halves in this order.
        self.codes.upper.push(sample_newest(sampler, &logits.upper));
        self.codes.lower.push(sample_newest(sampler, &logits.lower));
        Ok(())
    }
}

/// The codes from `first` on, each beside its row of music.
fn steps_from<'a>(first: usize, codes: &'a Codes, music: ArrayView2<'a, f32>) -> Steps<'a> {
    Steps {
        upper: codes.upper.get(first..).unwrap_or_default(),
        lower: codes.lower.get(first..).unwrap_or_default(),
        // The row beside code k is k + 1: the reference drops the first row.
        music: music.slice_axis_move(Axis(0), Slice::from(first + 1..codes.upper.len() + 1)),
    }
}

fn sample_newest(sampler: &mut Sampler, logits: &Array2<f32>) -> u32 {
    let newest = logits.row(logits.nrows().saturating_sub(1));
    // The vocabulary is at most u32::MAX: the manifest's check says so.
    sampler.next(newest.iter().copied()) as u32
}

/// Decodes a whole piece in overlapping chunks: the same as at once, with bounded memory. The
/// motion is in the manifest's frame still: a dancer's turns cannot be summed before chunks are joined.
///
/// The manifest's `receptive_codes` on either side of a chunk are decoded with it and dropped again; only the
/// piece's own ends see the zero padding (ARCHITECTURE section 2).
pub(crate) fn decode_codes(
    decoder: &mut Decoder,
    codes: &Codes,
    manifest: &Manifest,
    cancel: &CancelToken,
) -> Result<Array2<f32>, ModelError> {
    let receptive = manifest.decoder.receptive_codes;
    let frames_per_code = manifest.frames_per_code;
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
