//! The pose VQ-VAE: its networks, and a finished one that other stages build on.

use burn_tensor::backend::Backend;

use super::{
    checkpoint::Checkpoint,
    config::Config,
    error::TrainError,
    kept::{WEIGHT, read_kept},
    stage::Stage,
};
use crate::{
    HostTensor,
    nn::{Codebook, HalfNet, Parameters, Store, VqVaeSizes, random_vqvae},
    weights::VqVaeWeights,
};

/// Names of the halves in files.
pub(super) const HALVES: [&str; 2] = ["upper", "lower"];
/// Parts of a codebook in files.
const CODEBOOK_PARTS: [&str; 3] = ["entries", "sums", "counts"];

/// Networks of both halves, and the weights they start from.
pub(super) struct Halves {
    pub(super) nets: [HalfNet; 2],
    pub(super) store: Store,
    pub(super) weights: VqVaeWeights,
    /// Motion columns of each; `None` is always zero.
    pub(super) columns: [Vec<Option<usize>>; 2],
}

impl Halves {
    pub(super) fn new(config: &Config, weights: VqVaeWeights) -> Self {
        let mut store = Store::default();
        let [upper, lower] = HALVES;
        let upper = HalfNet::new(upper, &weights.upper, &mut store);
        let lower = match config.ablation.whole_body {
            // One network is both halves.
            true => upper.clone(),
            false => HalfNet::new(lower, &weights.lower, &mut store),
        };
        Self { nets: [upper, lower], store, weights, columns: config.pose_columns() }
    }

    pub(super) fn random(config: &Config) -> Self {
        let columns = config.pose_columns();
        let sizes = VqVaeSizes {
            half_columns: columns.map(|columns| columns.len()),
            width: config.vqvae.width,
            embedding: config.vqvae.embedding,
            codes: config.vqvae.codes,
            root_columns: config.data.root_columns().len(),
        };
        Self::new(config, random_vqvae(sizes, config.run.seed))
    }
}

/// Both halves of a finished VQ-VAE.
pub(super) struct FrozenVqVae<B: Backend> {
    pub(super) halves: Halves,
    pub(super) parameters: Parameters<B>,
    pub(super) codebooks: [Codebook<B>; 2],
}

impl<B: Backend> FrozenVqVae<B> {
    pub(super) fn read(config: &Config, device: &B::Device) -> Result<Self, TrainError> {
        let (path, checkpoint) = read_kept(config, Stage::VqVae)?;
        let mut halves = Halves::random(config);
        let fill = || {
            halves.store = checkpoint.fill(WEIGHT, &halves.store)?;
            let [upper, lower] = HALVES.map(|half| read_codebook(&checkpoint, half, device));
            Ok(Self {
                parameters: Parameters::from_store(&halves.store, device),
                codebooks: [upper?, lower?],
                halves,
            })
        };
        fill().map_err(TrainError::state(&path))
    }
}

/// Adds a half's codebook to a checkpoint.
pub(super) fn save_codebook<B: Backend>(
    checkpoint: &mut Checkpoint,
    half: &str,
    codebook: &Codebook<B>,
) {
    for (part, tensor) in CODEBOOK_PARTS.iter().zip(codebook.state()) {
        let name = format!("codebook.{half}.{part}");
        checkpoint.tensors.insert(name, tensor);
    }
}

/// Reads the entries of a half's codebook, `[codes, embedding]`.
pub(super) fn read_entries<'a>(
    checkpoint: &'a Checkpoint,
    half: &str,
) -> Result<&'a HostTensor, String> {
    let [entries, ..] = CODEBOOK_PARTS;
    checkpoint.tensor(&format!("codebook.{half}.{entries}"))
}

/// Reads a half's codebook.
pub(super) fn read_codebook<B: Backend>(
    checkpoint: &Checkpoint,
    half: &str,
    device: &B::Device,
) -> Result<Codebook<B>, String> {
    let parts = CODEBOOK_PARTS.map(|part| checkpoint.tensor(&format!("codebook.{half}.{part}")));
    let [entries, sums, counts] = parts;
    Ok(Codebook::from_state([entries?, sums?, counts?], device))
}
