//! A model directory from weights: graphs and manifest, written in one step.

mod error;
mod manifest;
mod skeleton;
mod staging;

pub use error::ExportError;
pub use manifest::{Description, PUBLISHED_HOP};
pub use skeleton::skeleton;
pub(crate) use staging::check_target;

use std::path::Path;

use bailando::model::{Manifest, ModelDirectory, STYLES_FILE};

use crate::{
    onnx::{InputRanges, decoder_graph, encoder_graph, gpt_graph},
    weights::{GptWeights, VqVaeWeights},
};
use staging::Staging;

/// The motion GPT's graph.
pub(crate) const GPT_FILE: &str = "gpt.onnx";
/// The graph that turns codes into motion.
pub(crate) const DECODER_FILE: &str = "decoder.onnx";
/// The graph that turns motion into codes.
pub(crate) const ENCODER_FILE: &str = "encoder.onnx";

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
        (GPT_FILE, gpt_graph(gpt, description.weights, ranges)?),
        (DECODER_FILE, decoder_graph(vqvae, description.weights)?),
        (ENCODER_FILE, encoder_graph(vqvae, description.weights)?),
    ];
    for (name, bytes) in graphs {
        let entry = staging.write(name, &bytes)?;
        manifest.files.insert(name.to_owned(), entry);
    }
    if let Some(classifier) = &description.classifier {
        let text = serde_json::to_vec(classifier).map_err(ExportError::Manifest)?;
        let entry = staging.write(STYLES_FILE, &text)?;
        manifest.files.insert(STYLES_FILE.to_owned(), entry);
    }
    publish(staging, manifest)
}

/// Writes the model directory `root`, whose manifest is `manifest`, again at `out` with another
/// motion GPT of the same sizes; `facts` are added to what the manifest says of the training.
///
/// # Errors
/// As [`write_model_directory`].
pub fn write_with_gpt(
    (root, mut manifest): (&Path, Manifest),
    (out, replace): (&Path, bool),
    gpt: &GptWeights,
    ranges: &InputRanges,
    facts: impl IntoIterator<Item = (String, serde_json::Value)>,
) -> Result<Manifest, ExportError> {
    manifest.training.extend(facts);
    let mut staging = Staging::beside(out, replace)?;
    for (name, entry) in &mut manifest.files {
        let bytes = match name.as_str() {
            GPT_FILE => gpt_graph(gpt, manifest.weights, ranges)?,
            _ => {
                let path = root.join(name);
                std::fs::read(&path).map_err(|source| ExportError::Read { path, source })?
            }
        };
        let written = staging.write(name, &bytes)?;
        if name != GPT_FILE && written != *entry {
            return Err(ExportError::Changed(root.join(name)));
        }
        *entry = written;
    }
    publish(staging, manifest)
}

/// Adds the manifest, and puts what can be loaded in its place.
fn publish(mut staging: Staging, manifest: Manifest) -> Result<Manifest, ExportError> {
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
    directory.style_classifier()?;
    Ok(())
}
