//! Decoding of codes to motion, as the server does it, on the training device.

use bailando::motion::{Positions, integrate_root, to_world_frame};
use burn_tensor::Tensor;
use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

use super::{
    config::Config, error::TrainError, frozen::FrozenVqVae, stage::Stage, velocity::Decoders,
};
use crate::{
    data::FRAMES_PER_CODE,
    nn::{self, Kernels, Parameters, numbers, values},
};

/// Columns of positions.
const COLUMNS: usize = 72;
/// Most pieces that are decoded at once, which bounds the memory of their activations.
const SIDE_BY_SIDE: usize = 256;

/// The decoders of a finished VQ-VAE and its root branch.
pub(super) struct MotionDecoder<B: Kernels> {
    frozen: FrozenVqVae<B>,
    /// Those of stage `velocity`; none where the lower half gives the root's columns.
    velocity: Option<(Decoders, Parameters<B>)>,
    root_columns: &'static [usize],
    device: B::Device,
}

impl<B: Kernels> MotionDecoder<B> {
    pub(super) fn read(config: &Config, device: &B::Device) -> Result<Self, TrainError> {
        let velocity = if Stage::Velocity.is_part_of(config) {
            let decoders = Decoders::trained(config)?;
            let parameters = Parameters::from_store(&decoders.store, device);
            Some((decoders, parameters))
        } else {
            None
        };
        Ok(Self {
            frozen: FrozenVqVae::read(config, device)?,
            velocity,
            root_columns: config.data.root_columns(),
            device: device.clone(),
        })
    }

    /// Returns the numbers of upper and lower codes.
    pub(super) fn codes(&self) -> [usize; 2] {
        self.frozen.codebooks.each_ref().map(|codebook| {
            let [codes, _] = codebook.entries().dims();
            codes
        })
    }

    /// Decodes a whole piece to world positions, 8 frames a code; `None` where a decoder gives NaN.
    pub(super) fn positions(&self, codes: &[Vec<i32>; 2]) -> Option<Positions> {
        self.positions_of_equals(std::slice::from_ref(codes)).pop()?
    }

    /// Decodes many pieces, side by side where neighbours are of one length.
    pub(super) fn positions_of_many(&self, pieces: &[[Vec<i32>; 2]]) -> Vec<Option<Positions>> {
        let equals = pieces.chunk_by(|[one, _], [other, _]| one.len() == other.len());
        let some = equals.flat_map(|equals| equals.chunks(SIDE_BY_SIDE));
        some.flat_map(|some| self.positions_of_equals(some)).collect()
    }

    fn positions_of_equals(&self, pieces: &[[Vec<i32>; 2]]) -> Vec<Option<Positions>> {
        self.decoded([0, 1].map(|half| self.entries(pieces, half)))
    }

    /// Decodes vectors in place of codebook entries, one code's values after the other's.
    pub(super) fn positions_of_vectors(&self, vectors: [Vec<f32>; 2]) -> Option<Positions> {
        let [_, channels] = self.frozen.codebooks[0].entries().dims();
        let embedded = vectors.map(|vectors| {
            let shape = [1, vectors.len() / channels, channels];
            numbers(vectors, shape, &self.device)
        });
        self.decoded(embedded).pop()?
    }

    /// Returns the codebook entries of an upper and a lower code.
    pub(super) fn pair(&self, codes: [i32; 2]) -> [Vec<f32>; 2] {
        let codes = [codes.map(|code| vec![code])];
        [0, 1].map(|half| values(&self.entries(&codes, half)))
    }

    /// Decodes each piece of a batch to positions.
    fn decoded(&self, embedded: [Tensor<B, 3>; 2]) -> Vec<Option<Positions>> {
        // A fourth column is the dancer's turn: the motion is in the dancer's frame.
        let turning = self.root_columns.len() - 3;
        let [pieces, codes, _] = embedded[0].dims();
        let frames = codes * FRAMES_PER_CODE;
        let mut columns = Array2::zeros((pieces * frames, COLUMNS + turning));
        let halves = &self.frozen.halves;
        for (half, (net, places)) in halves.nets.iter().zip(&halves.columns).enumerate() {
            let fine_tuned = self.velocity.as_ref().and_then(|(decoders, parameters)| {
                let halves = decoders.halves.as_ref()?;
                Some((&halves[half], parameters))
            });
            let (decoder, parameters) =
                fine_tuned.unwrap_or((&net.decoder, &self.frozen.parameters));
            let decoded = decoder.forward(parameters, embedded[half].clone());
            fill(&mut columns, frames, &values(&decoded), places);
        }
        if let Some((decoders, parameters)) = &self.velocity {
            let [_, lower] = embedded;
            let decoded = decoders.root.forward(parameters, lower);
            let places: Vec<_> = self.root_columns.iter().copied().map(Some).collect();
            fill(&mut columns, frames, &values(&decoded), &places);
        }
        let placed = |piece: ArrayView2<'_, f32>| {
            if turning == 0 {
                return integrate_root(piece, [0.0; 3]).ok();
            }
            let world = to_world_frame(piece).ok()?;
            integrate_root(world.view(), [0.0; 3]).ok()
        };
        let pieces: Vec<_> = columns.axis_chunks_iter(Axis(0), frames.max(1)).collect();
        pieces.into_par_iter().map(placed).collect()
    }

    /// Looks up the entries of one half, `[pieces, codes, channels]`; all pieces have one length.
    fn entries(&self, pieces: &[[Vec<i32>; 2]], half: usize) -> Tensor<B, 3> {
        let codes: Vec<i32> = pieces.iter().flat_map(|piece| &piece[half]).copied().collect();
        let length = codes.len();
        let codes = nn::codes(codes, [length], &self.device);
        let entries = self.frozen.codebooks[half].lookup(codes);
        let [_, channels] = entries.dims();
        entries.reshape([pieces.len(), length / pieces.len().max(1), channels])
    }
}

/// Copies decoded columns to their places, in pieces of `frames` rows.
fn fill(columns: &mut Array2<f32>, frames: usize, decoded: &[f32], places: &[Option<usize>]) {
    let pieces: Vec<_> = columns.axis_chunks_iter_mut(Axis(0), frames.max(1)).collect();
    let decoded = decoded.par_chunks((frames * places.len()).max(1));
    let filled = pieces.into_par_iter().zip(decoded);
    filled.for_each(|(mut piece, decoded)| {
        let rows = decoded.chunks(places.len());
        for (mut row, decoded) in piece.outer_iter_mut().zip(rows) {
            for (place, &value) in places.iter().zip(decoded) {
                if let Some(column) = *place {
                    row[column] = value;
                }
            }
        }
    });
}
