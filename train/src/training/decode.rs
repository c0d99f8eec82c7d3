//! Decoding of codes to motion, as the server does it, on the training device.

use bailando::motion::{Positions, integrate_root, to_world_frame};
use burn_flex::{Flex, FlexDevice};
use burn_tensor::Tensor;
use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

use super::{
    config::Config,
    error::TrainError,
    frozen::{FrozenVqVae, HALVES},
    stage::Stage,
    velocity::Decoders,
};
use crate::{
    data::FRAMES_PER_CODE,
    nn::{self, Codebook, DecoderNet, Kernels, Parameters, Store, numbers, values},
    weights::MotionWeights,
};

/// Columns of positions.
const COLUMNS: usize = 72;
/// Most pieces that are decoded at once, which bounds the memory of their activations.
const SIDE_BY_SIDE: usize = 256;

/// Decoders of both halves and of the root's velocity, on a device.
pub(super) struct MotionDecoder<B: Kernels> {
    codebooks: [Codebook<B>; 2],
    halves: [DecoderNet; 2],
    /// None where the lower half gives the root's columns.
    root: Option<DecoderNet>,
    parameters: Parameters<B>,
    /// Motion columns of each half.
    columns: [Vec<Option<usize>>; 2],
    root_columns: &'static [usize],
    device: B::Device,
}

impl<B: Kernels> MotionDecoder<B> {
    /// Reads that of a finished VQ-VAE and its root branch.
    pub(super) fn read(config: &Config, device: &B::Device) -> Result<Self, TrainError> {
        Ok(Self::new(config, &motion_weights(config)?, device))
    }

    /// Plans the decoders of some weights.
    pub(super) fn new(config: &Config, weights: &MotionWeights, device: &B::Device) -> Self {
        let mut store = Store::default();
        let [upper, lower] = HALVES;
        let [first, second] = &weights.halves;
        let halves =
            [DecoderNet::new(upper, first, &mut store), DecoderNet::new(lower, second, &mut store)];
        let root = weights.root.as_ref();
        Self {
            root: root.map(|root| DecoderNet::new("root", root, &mut store)),
            halves,
            codebooks: weights.codebooks.each_ref().map(|entries| Codebook::new(entries, device)),
            parameters: Parameters::from_store(&store, device),
            columns: config.pose_columns(),
            root_columns: config.data.root_columns(),
            device: device.clone(),
        }
    }

    /// Returns the numbers of upper and lower codes.
    pub(super) fn codes(&self) -> [usize; 2] {
        self.codebooks.each_ref().map(|codebook| {
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
        let [_, channels] = self.codebooks[0].entries().dims();
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
        for ((net, places), embedded) in self.halves.iter().zip(&self.columns).zip(&embedded) {
            let decoded = net.forward(&self.parameters, embedded.clone());
            fill(&mut columns, frames, &values(&decoded), places);
        }
        if let Some(root) = &self.root {
            let [_, lower] = embedded;
            let decoded = root.forward(&self.parameters, lower);
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
        let entries = self.codebooks[half].lookup(codes);
        let [_, channels] = entries.dims();
        entries.reshape([pieces.len(), length / pieces.len().max(1), channels])
    }
}

/// Reads the codebooks and decoders of a finished VQ-VAE, and those of its root branch.
pub(super) fn motion_weights(config: &Config) -> Result<MotionWeights, TrainError> {
    let frozen = FrozenVqVae::<Flex>::read(config, &FlexDevice)?;
    let trained = match Stage::Velocity.is_part_of(config) {
        true => Some(Decoders::trained(config)?),
        false => None,
    };
    let half = |half: usize| {
        let fine_tuned = trained
            .as_ref()
            .and_then(|decoders| Some(decoders.halves.as_ref()?[half].weights(&decoders.store)));
        fine_tuned.unwrap_or_else(|| {
            let halves = &frozen.halves;
            halves.nets[half].decoder.weights(&halves.store)
        })
    };
    Ok(MotionWeights {
        codebooks: frozen.codebooks.each_ref().map(|codebook| {
            let [entries, ..] = codebook.state();
            entries
        }),
        halves: [half(0), half(1)],
        root: trained.as_ref().map(|decoders| decoders.root.weights(&decoders.store)),
    })
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
