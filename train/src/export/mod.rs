//! A model directory from weights: graphs and manifest, written in one step.

mod error;
mod manifest;
mod skeleton;
mod staging;

pub use error::ExportError;
pub use skeleton::skeleton;
pub(crate) use staging::check_target;

use std::{collections::BTreeMap, path::Path};

use bailando::{
    features::Profile,
    model::{Manifest, ModelDirectory, SuppressedCodes, WeightStorage},
    motion::MotionFrame,
};

use crate::{
    onnx::{InputRanges, decoder_graph, encoder_graph, gpt_graph},
    weights::{GptWeights, VqVaeWeights},
};
use staging::Staging;

/// Codes that a window keeps when it moves, as the golden vectors and the model cards have it.
pub const PUBLISHED_HOP: usize = 15;

/// The manifest's entries that do not follow from the weights.
#[derive(Clone, Debug)]
pub struct Description {
    /// Name of the model.
    pub name: String,
    /// Licence of the weights.
    pub licence: String,
    /// Feature chain that the model was trained with.
    pub profile: Profile,
    /// Periods in counts that the model is conditioned on, after the features.
    pub count_periods: Vec<u32>,
    /// Pairs (upper, lower) to draw a start from; empty: any pair.
    pub start_codes: Vec<[u32; 2]>,
    /// Codes that are never drawn.
    pub suppressed_codes: SuppressedCodes,
    /// Default temperature; 0 takes the most likely code.
    pub temperature: f32,
    /// Default scale of classifier-free guidance by the music; 1 is none.
    pub guidance: f32,
    /// Default number of candidates for a segment; 1 takes the first.
    pub candidates: usize,
    /// Whether segments that stand still are regenerated.
    pub redo: bool,
    /// Codes that a window keeps when it moves ([`PUBLISHED_HOP`]); at most the context.
    pub hop: usize,
    /// Frame of the motion that the weights were trained on.
    pub motion_frame: MotionFrame,
    /// Height in metres at which the root starts.
    pub root_height: f32,
    /// How weights are stored.
    pub weights: WeightStorage,
    /// How the model was trained.
    pub training: BTreeMap<String, serde_json::Value>,
}

/// Writes a model directory at `out`, checked by loading it before it takes its place.
///
/// 8-bit weights take the ranges of their inputs from `ranges`; without one they find it at run
/// time.
///
/// An existing directory is only replaced with `replace`, and only if it is empty or a model
/// directory; files that the new one does not have (a model card) stay.
///
/// # Errors
/// [`ExportError`]; `out` is as it was then.
pub fn write_model_directory(
    out: &Path,
    replace: bool,
    gpt: &GptWeights,
    ranges: &InputRanges,
    vqvae: &VqVaeWeights,
    description: &Description,
) -> Result<Manifest, ExportError> {
    let mut manifest = manifest::manifest(gpt, vqvae, description)?;
    let mut staging = Staging::beside(out, replace)?;
    let graphs = [
        ("gpt.onnx", gpt_graph(gpt, description.weights, ranges)?),
        ("decoder.onnx", decoder_graph(vqvae, description.weights)?),
        ("encoder.onnx", encoder_graph(vqvae, description.weights)?),
    ];
    for (name, bytes) in graphs {
        let entry = staging.write(name, &bytes)?;
        manifest.files.insert(name.to_owned(), entry);
    }
    let mut text = serde_json::to_string_pretty(&manifest).map_err(ExportError::Manifest)?;
    text.push('\n');
    staging.write("manifest.json", text.as_bytes())?;
    load(staging.folder())?;
    staging.publish()?;
    Ok(manifest)
}

/// Opens everything that the server opens.
fn load(folder: &Path) -> Result<(), ExportError> {
    let directory = ModelDirectory::open(folder)?;
    directory.gpt(1)?;
    directory.decoder(1)?;
    directory.encoder(1)?;
    Ok(())
}
