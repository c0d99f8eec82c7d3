//! Codes to dances, as the server decodes them but on the training device.

use bailando::motion::{Positions, integrate_root, to_world_frame};
use burn_tensor::{Int, Tensor as Device, TensorData};
use ndarray::Array2;

use super::{Config, FRAMES_PER_CODE, Stage, TrainError, velocity::Decoders, vqvae::Trained};
use crate::nn::{Kernels, Parameters, values};

/// Columns of positions.
const COLUMNS: usize = 72;

/// The decoders of a finished VQ-VAE and its root branch.
pub(super) struct DanceDecoder<B: Kernels> {
    trained: Trained<B>,
    /// Those of stage `velocity`; none where the lower half gives the root's columns.
    later: Option<(Decoders, Parameters<B>)>,
    root_columns: &'static [usize],
    device: B::Device,
}

impl<B: Kernels> DanceDecoder<B> {
    pub(super) fn read(config: &Config, device: &B::Device) -> Result<Self, TrainError> {
        let later = if config.has(Stage::Velocity) {
            let decoders = Decoders::trained(config)?;
            let parameters = Parameters::from_store(&decoders.store, device);
            Some((decoders, parameters))
        } else {
            None
        };
        Ok(Self {
            trained: Trained::read(config, device)?,
            later,
            root_columns: config.data.root_columns(),
            device: device.clone(),
        })
    }

    /// World positions of a whole piece from its upper and lower codes, 8 frames a code; none where
    /// a decoder gives what is no number.
    pub(super) fn positions(&self, codes: &[Vec<i32>; 2]) -> Option<Positions> {
        self.decoded([0, 1].map(|half| self.entries(codes, half)))
    }

    /// The same from vectors in place of codebook entries, one code's values after the other's.
    pub(super) fn positions_of_vectors(&self, vectors: [Vec<f32>; 2]) -> Option<Positions> {
        let [_, channels] = self.trained.codebooks[0].entries().dims();
        self.decoded(vectors.map(|vectors| {
            let shape = [1, vectors.len() / channels, channels];
            Device::from_data(TensorData::new(vectors, shape), &self.device)
        }))
    }

    /// The codebook entries of upper and lower code.
    pub(super) fn pair(&self, codes: [i32; 2]) -> [Vec<f32>; 2] {
        let codes = codes.map(|code| vec![code]);
        [0, 1].map(|half| values(&self.entries(&codes, half)))
    }

    fn decoded(&self, embedded: [Device<B, 3>; 2]) -> Option<Positions> {
        // A fourth column is the dancer's turning: the motion is in the dancer's frame.
        let turning = self.root_columns.len() - 3;
        let [_, codes, _] = embedded[0].dims();
        let frames = codes * FRAMES_PER_CODE;
        let mut columns = Array2::zeros((frames, COLUMNS + turning));
        let halves = &self.trained.halves;
        for (half, (net, places)) in halves.nets.iter().zip(&halves.columns).enumerate() {
            let learned_on = self.later.as_ref().and_then(|(decoders, parameters)| {
                let halves = decoders.halves.as_ref()?;
                Some((&halves[half], parameters))
            });
            let (decoder, parameters) =
                learned_on.unwrap_or((&net.decoder, &self.trained.parameters));
            let decoded = decoder.forward(parameters, embedded[half].clone());
            fill(&mut columns, &values(&decoded), places);
        }
        if let Some((decoders, parameters)) = &self.later {
            let [_, lower] = embedded;
            let decoded = decoders.root.forward(parameters, lower);
            let places: Vec<_> = self.root_columns.iter().copied().map(Some).collect();
            fill(&mut columns, &values(&decoded), &places);
        }
        let world = if turning == 0 {
            columns
        } else {
            to_world_frame(columns.view()).ok()?
        };
        integrate_root(world.view(), [0.0; 3]).ok()
    }

    /// Codebook entries of one half, `[1, codes, channels]`.
    fn entries(&self, codes: &[Vec<i32>; 2], half: usize) -> Device<B, 3> {
        let codes = codes[half].clone();
        let shape = [codes.len()];
        let codes = Device::<B, 1, Int>::from_data(TensorData::new(codes, shape), &self.device);
        self.trained.codebooks[half].lookup(codes).unsqueeze_dim(0)
    }
}

/// Puts decoded columns where they belong.
fn fill(columns: &mut Array2<f32>, decoded: &[f32], places: &[Option<usize>]) {
    let rows = decoded.chunks(places.len());
    for (mut row, decoded) in columns.outer_iter_mut().zip(rows) {
        for (place, &value) in places.iter().zip(decoded) {
            if let Some(column) = *place {
                row[column] = value;
            }
        }
    }
}
