//! Import of official checkpoints into a model directory.

use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
};

use bailando::model::Manifest;
use serde::de::DeserializeOwned;

use crate::{
    checkpoint::{CheckpointError, TorchCheckpoint},
    export::{Description, ExportError, write_model_directory},
    onnx::InputRanges,
    weights::{GptWeights, VqVaeWeights, WeightError},
};

/// The pair that the authors' demonstration starts with (ARCHITECTURE section 3).
const OFFICIAL_START: [u32; 2] = [423, 12];

/// The checkpoints to import, and facts that they do not hold.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// Checkpoint of the pose VQ-VAE.
    pub vqvae: PathBuf,
    /// Checkpoint of the motion GPT.
    pub gpt: PathBuf,
    /// Directory to write.
    pub out: PathBuf,
    /// Whether a model that is already there is replaced.
    pub replace: bool,
    /// Attention heads, which no tensor's shape gives.
    pub heads: usize,
    /// JSON with start codes.
    pub start_codes: Option<PathBuf>,
    /// JSON object for the manifest's `training`.
    pub training: Option<PathBuf>,
    /// Everything else; start codes and training are taken from the files above.
    pub description: Description,
}

/// A network that a checkpoint may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Network {
    /// Both halves of the pose VQ-VAE.
    VqVae,
    /// The motion GPT.
    Gpt,
}

impl Network {
    /// Prefix of its tensors.
    const fn prefix(self) -> &'static str {
        match self {
            Self::VqVae => "vqvae_",
            Self::Gpt => "gpt_",
        }
    }

    const fn flag(self) -> &'static str {
        match self {
            Self::VqVae => "--vqvae",
            Self::Gpt => "--gpt",
        }
    }

    fn is_in(self, checkpoint: &TorchCheckpoint) -> bool {
        checkpoint.names().any(|name| name.starts_with(self.prefix()))
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::VqVae => "pose VQ-VAE",
            Self::Gpt => "motion GPT",
        })
    }
}

/// Why checkpoints could not be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages are the documentation")]
pub enum ImportError {
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    Weights(#[from] WeightError),
    #[error(transparent)]
    Export(#[from] ExportError),
    #[error("{}: this is a {found}, not a {wanted}: give it with {flag}{other}", path.display())]
    OtherNetwork {
        path: PathBuf,
        found: Network,
        wanted: Network,
        flag: &'static str,
        other: &'static str,
    },
    #[error("{}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: expected {expected}: {source}", path.display())]
    Json { path: PathBuf, expected: &'static str, source: serde_json::Error },
    #[error("{}: start codes {pair:?} lie outside the vocabulary of {upper} upper and {lower} \
             lower codes", path.display())]
    StartCode { path: PathBuf, pair: [u32; 2], upper: usize, lower: usize },
}

/// Imports; returns the manifest that was written.
///
/// # Errors
/// [`ImportError`], one line that names the file and the tensor, expected and found. Nothing is
/// left behind then.
pub fn import(options: &ImportOptions) -> Result<Manifest, ImportError> {
    let mut vqvae = TorchCheckpoint::open(&options.vqvae)?;
    let mut gpt = TorchCheckpoint::open(&options.gpt)?;
    check_networks(&vqvae, &gpt)?;
    let vqvae = VqVaeWeights::from_checkpoint(&mut vqvae)?;
    let gpt = GptWeights::from_checkpoint(&mut gpt, options.heads)?;
    let mut description = options.description.clone();
    description.start_codes = start_codes(options.start_codes.as_deref(), &gpt)?;
    if let Some(path) = &options.training {
        description.training =
            read_json::<BTreeMap<_, _>>(path, "an object that describes the training")?;
    }
    let (out, replace) = (&options.out, options.replace);
    Ok(write_model_directory(out, replace, &gpt, &InputRanges::default(), &vqvae, &description)?)
}

/// Refuses files that were swapped, and one that was given twice.
fn check_networks(vqvae: &TorchCheckpoint, gpt: &TorchCheckpoint) -> Result<(), ImportError> {
    let is_other = |file: &TorchCheckpoint, wanted: Network, found: Network| {
        found.is_in(file) && !wanted.is_in(file)
    };
    let swapped = is_other(vqvae, Network::VqVae, Network::Gpt);
    let gpt_too = is_other(gpt, Network::Gpt, Network::VqVae);
    let other = if swapped && gpt_too { " (the two files are swapped)" } else { "" };
    let error = |file: &TorchCheckpoint, wanted, found: Network| ImportError::OtherNetwork {
        path: file.path().to_owned(),
        found,
        wanted,
        flag: found.flag(),
        other,
    };
    match (swapped, gpt_too) {
        (true, _) => Err(error(vqvae, Network::VqVae, Network::Gpt)),
        (false, true) => Err(error(gpt, Network::Gpt, Network::VqVae)),
        (false, false) => Ok(()),
    }
}

/// Reads the file's pairs; without a file the official pair where the vocabulary has it, else none.
fn start_codes(path: Option<&Path>, gpt: &GptWeights) -> Result<Vec<[u32; 2]>, ImportError> {
    let (upper, lower) = (gpt.upper_embedding.dim(0), gpt.lower_embedding.dim(0));
    let known = |&[u, l]: &[u32; 2]| (u as usize) < upper && (l as usize) < lower;
    let Some(path) = path else {
        return Ok(Some(OFFICIAL_START).filter(known).into_iter().collect());
    };
    let expected = "a list of pairs [upper, lower], or an object with it as `start_codes`";
    let mut content: serde_json::Value = read_json(path, expected)?;
    // Other keys of an object are ignored.
    if let Some(list) = content.get_mut("start_codes") {
        content = list.take();
    }
    let pairs: Vec<[u32; 2]> = serde_json::from_value(content)
        .map_err(|source| ImportError::Json { path: path.to_owned(), expected, source })?;
    match pairs.iter().find(|pair| !known(pair)) {
        None => Ok(pairs),
        Some(&pair) => Err(ImportError::StartCode { path: path.to_owned(), pair, upper, lower }),
    }
}

fn read_json<T: DeserializeOwned>(path: &Path, expected: &'static str) -> Result<T, ImportError> {
    let text = std::fs::read(path)
        .map_err(|source| ImportError::Read { path: path.to_owned(), source })?;
    serde_json::from_slice(&text).map_err(|source| ImportError::Json {
        path: path.to_owned(),
        expected,
        source,
    })
}
