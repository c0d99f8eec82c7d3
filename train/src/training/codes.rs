//! Pose codes of whole motions, for the stages that learn from codes.

use std::io::Write;

use rayon::prelude::*;

use super::{crops::motion_columns, frozen::FrozenVqVae, piece::MotionPiece};
use crate::{
    data::{Draw, FRAMES_PER_CODE},
    nn::{Kernels, values},
};

/// Motions between two lines of progress.
const DANCES_A_LINE: usize = 16;
/// Frames that are encoded at once, to bound the memory.
const FRAMES_AT_ONCE: usize = 16_384;

/// Upper and lower codes of a whole motion.
pub(super) type Pair = [Vec<i32>; 2];

/// Codes of each motion at each start phase, and of its mirror image where that is wanted.
pub(super) struct Codes {
    motions: Vec<Variants>,
}

struct Variants {
    phases: usize,
    /// All phases as they are, then all phases in the mirror.
    codes: Vec<Pair>,
    /// The encoders' outputs for the same, one code's values after the other's; only where wanted.
    vectors: Vec<[Vec<f32>; 2]>,
}

/// The variants that are encoded.
#[derive(Clone, Copy)]
pub(super) struct Augmentation {
    pub(super) mirror: bool,
    pub(super) phases: usize,
    /// Whether the encoders' outputs are kept beside the codes.
    pub(super) vectors: bool,
}

impl Codes {
    /// Encodes all motions, several at a time, and reports progress.
    pub(super) fn encode<B: Kernels>(
        frozen: &FrozenVqVae<B>,
        pieces: &[MotionPiece],
        wanted: Augmentation,
        device: &B::Device,
        output: &mut impl Write,
    ) -> Self {
        let mut motions = Vec::with_capacity(pieces.len());
        for some in pieces.chunks(DANCES_A_LINE) {
            let encoded = some.par_iter();
            let encoded = encoded.map(|piece| variants(frozen, piece, wanted, device));
            motions.par_extend(encoded);
            // Progress that cannot be shown is no reason to stop.
            let _ = writeln!(output, "codes of {}/{} motions", motions.len(), pieces.len());
        }
        Self { motions }
    }

    /// Takes the codes of one motion at its start phases.
    #[cfg(test)]
    pub(super) fn of_one(phases: Vec<Pair>) -> Self {
        let dance = Variants { phases: phases.len(), codes: phases, vectors: Vec::new() };
        Self { motions: vec![dance] }
    }

    /// Returns the codes that a window is cut from.
    pub(super) fn of(&self, window: &Draw) -> &Pair {
        let dance = &self.motions[window.dance];
        &dance.codes[usize::from(window.mirrored) * dance.phases + window.phase]
    }

    /// Returns the codes of the window's motion and side from `frame` of the stored motion on;
    /// `None` beyond its end. All start phases must be encoded.
    pub(super) fn beginning_at(&self, window: &Draw, frame: usize) -> Option<[&[i32]; 2]> {
        let phase = frame % FRAMES_PER_CODE;
        let [upper, lower] = self.of(&Draw { phase, ..*window });
        let first = frame / FRAMES_PER_CODE;
        Some([upper.get(first..)?, lower.get(first..)?])
    }

    /// Returns the vectors of these codes.
    pub(super) fn vectors_of(&self, window: &Draw) -> &[Vec<f32>; 2] {
        let dance = &self.motions[window.dance];
        &dance.vectors[usize::from(window.mirrored) * dance.phases + window.phase]
    }

    /// Returns each motion's codes from its first frame on and those of its mirror image.
    pub(super) fn whole(&self, motion: usize) -> impl Iterator<Item = &Pair> {
        let motion = &self.motions[motion];
        motion.codes.iter().step_by(motion.phases)
    }

    /// Returns the codes that every motion and mirror image begins with, with the motion's number;
    /// `firsts` has the first frame of each motion that is learned.
    pub(super) fn starts(&self, firsts: &[usize]) -> impl Iterator<Item = (usize, [u32; 2])> {
        let motions = firsts.iter().enumerate().take(self.motions.len());
        let whole = motions.flat_map(|(motion, first)| {
            let code = first.div_ceil(FRAMES_PER_CODE);
            let whole = self.whole(motion);
            whole.map(move |pair| (motion, pair.each_ref().map(|half| half.get(code).copied())))
        });
        whole.filter_map(|(motion, [upper, lower])| {
            Some((motion, [upper?, lower?].map(|code| code as u32)))
        })
    }
}

fn variants<B: Kernels>(
    frozen: &FrozenVqVae<B>,
    piece: &MotionPiece,
    wanted: Augmentation,
    device: &B::Device,
) -> Variants {
    let phases = wanted.phases.max(1);
    let sides: &[bool] = if wanted.mirror { &[false, true] } else { &[false] };
    let all = sides.iter().flat_map(|&mirrored| {
        (0..phases).map(move |phase| Draw { phase, mirrored, ..Draw::default() })
    });
    let all: Vec<Draw> = all.collect();
    let length = |draw: &Draw| piece.frames().saturating_sub(draw.phase) / FRAMES_PER_CODE;
    let mut codes = vec![Pair::default(); all.len()];
    let kept = if wanted.vectors { all.len() } else { 0 };
    let mut vectors: Vec<[Vec<f32>; 2]> = vec![Default::default(); kept];
    // Cutting frames off leaves one of two lengths; encoders take only equal ones together.
    for codes_each in [length(&all[0]), length(&all[0]).saturating_sub(1)] {
        let frames = codes_each * FRAMES_PER_CODE;
        let places = (0..all.len()).filter(|&place| length(&all[place]) == codes_each);
        let places: Vec<usize> = places.filter(|_| frames > 0).collect();
        for places in places.chunks((FRAMES_AT_ONCE / frames.max(1)).max(1)) {
            let draws: Vec<Draw> = places.iter().map(|&place| all[place]).collect();
            for half in [0, 1] {
                let columns = &frozen.halves.columns[half];
                let piece = std::slice::from_ref(piece);
                let motion = motion_columns(piece, &draws, frames, columns, device);
                let (net, table) = (&frozen.halves.nets[half], &frozen.codebooks[half]);
                let found = net.encoder.forward(&frozen.parameters, motion);
                let [batch, codes_found, channels] = found.dims();
                let flat = found.clone().reshape([batch * codes_found, channels]);
                let nearest = table.nearest(flat);
                let nearest: Vec<i32> = nearest.into_data().iter::<i32>().collect();
                for (&place, nearest) in places.iter().zip(nearest.chunks(codes_each)) {
                    codes[place][half] = nearest.to_vec();
                }
                let found = if wanted.vectors { values(&found) } else { Vec::new() };
                for (&place, found) in places.iter().zip(found.chunks(codes_each * channels)) {
                    vectors[place][half] = found.to_vec();
                }
            }
        }
    }
    Variants { phases, codes, vectors }
}
