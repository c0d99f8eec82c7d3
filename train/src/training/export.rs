//! Stage `export`: the trained parts as a model directory.

use std::path::Path;

use bailando::model::{Manifest, ModelDirectory, SamplingDefaults, SuppressedCodes};
use burn_flex::{Flex, FlexDevice};
use serde_json::{Value, json};

use super::{
    calibrate::input_ranges, config::Config, decode::motion_weights, error::TrainError,
    frozen::FrozenVqVae, kept::fingerprint, policy::Policy, song_styles::read_classifier,
    stage::Stage, suppress::suppressed_codes,
};
use crate::{
    export::{Description, ExportError, write_model_directory},
    weights::{GptWeights, HalfWeights, VqVaeWeights},
};

/// Entries of the manifest's `training`.
const CHECKPOINTS: &str = "checkpoints";
const SETTINGS: &str = "settings";

/// Writes the model directory of a finished run.
///
/// # Errors
/// [`TrainError::StageMissing`] where a stage is not finished; what cannot be read or written.
pub fn export(config: &Config, replace: bool) -> Result<Manifest, TrainError> {
    write(config, &config.export.folder, Policy::latest(config)?, replace, [])
}

/// Writes a model directory with any policy; `facts` are added to the manifest's `training`.
pub(super) fn write<const N: usize>(
    config: &Config,
    folder: &Path,
    policy: Policy,
    replace: bool,
    facts: [(&str, serde_json::Value); N],
) -> Result<Manifest, TrainError> {
    config.ablation.refuse("export")?;
    let training = [
        ("seed", config.run.seed.into()),
        ("data", data_folders(config)),
        (CHECKPOINTS, checkpoints(config)?),
        (SETTINGS, settings(config)?),
    ];
    let training = training.into_iter().chain(facts);
    let suppressed_codes = suppressed_codes(config)?;
    let description = Description {
        name: config.export.name.clone(),
        licence: config.export.licence.clone(),
        profile: config.data.profile,
        count_periods: config.data.count_periods.clone(),
        counts: config.data.counts,
        styles: policy.manners.styles.clone(),
        energy: policy.manners.energy,
        classifier: read_classifier(config, &policy.manners.styles)?,
        start_codes: allowed_starts(&policy.starts, &suppressed_codes),
        style_start_codes: policy
            .style_starts
            .iter()
            .map(|(style, starts)| (style.clone(), allowed_starts(starts, &suppressed_codes)))
            .collect(),
        style_codes: policy.style_codes.clone(),
        suppressed_codes,
        temperature: config.export.temperature,
        guidance: config.export.guidance,
        candidates: config.export.candidates,
        redo: config.export.redo,
        hop: config.export.hop,
        motion_frame: config.data.frame,
        root_height: config.export.root_height,
        weights: config.export.weights,
        training: training.map(|(name, value)| (name.to_owned(), value)).collect(),
    };
    Ok(write_model_directory(
        folder,
        replace,
        &policy.weights(),
        &input_ranges(config, &policy),
        &vqvae_weights(config)?,
        &description,
    )?)
}

/// Returns the data folder, or all of them with their weights.
fn data_folders(config: &Config) -> Value {
    let folders = config.data.all_folders();
    let text = |path: &Path| Value::from(path.display().to_string());
    match &folders[..] {
        [folder] if folder.weight == 1.0 => text(&folder.path),
        folders => {
            let folders = folders.iter();
            folders
                .map(|folder| json!({"path": text(&folder.path), "weight": folder.weight}))
                .collect()
        }
    }
}

/// Returns the starts without suppressed codes.
fn allowed_starts(starts: &[[u32; 2]], suppressed: &SuppressedCodes) -> Vec<[u32; 2]> {
    let allowed = |&&[upper, lower]: &&[u32; 2]| {
        !suppressed.upper.contains(&upper) && !suppressed.lower.contains(&lower)
    };
    starts.iter().filter(allowed).copied().collect()
}

/// Returns the settings that the weights were trained with.
fn settings(config: &Config) -> Result<Value, TrainError> {
    let learned = Policy::latest_stage(config)? == Stage::ActorCritic;
    let mut settings = serde_json::to_value(config).map_err(ExportError::Manifest)?;
    if let Value::Object(sections) = &mut settings {
        sections.retain(|section, _| match section.as_str() {
            "vqvae" | "velocity" | "gpt" => true,
            section => learned && section == "actor_critic",
        });
    }
    Ok(settings)
}

/// Returns the stages whose weights are exported.
fn contributing(config: &Config) -> Result<[Stage; 3], TrainError> {
    Ok([Stage::VqVae, Stage::Velocity, Policy::latest_stage(config)?])
}

/// Returns the SHA-256 of the file that each stage contributes.
fn checkpoints(config: &Config) -> Result<Value, TrainError> {
    let sum = |stage: Stage| Ok((stage.name().to_owned(), fingerprint(config, stage)?.into()));
    let sums: Result<_, TrainError> = contributing(config)?.into_iter().map(sum).collect();
    Ok(Value::Object(sums?))
}

/// Whether the model directory exists, is made of the stages as they are, and has the configured
/// description.
pub(super) fn is_exported(config: &Config) -> Result<bool, TrainError> {
    let Ok(directory) = ModelDirectory::open(&config.export.folder) else {
        return Ok(false);
    };
    let (manifest, asked) = (directory.manifest(), &config.export);
    let sampling = SamplingDefaults {
        temperature: asked.temperature,
        guidance: asked.guidance,
        candidates: asked.candidates,
        redo: asked.redo,
        hop: asked.hop.min(manifest.gpt.context),
        ..manifest.sampling
    };
    let described = (&manifest.name, &manifest.licence, manifest.weights)
        == (&asked.name, &asked.licence, asked.weights)
        && manifest.sampling == sampling
        && manifest.skeleton.root_height == asked.root_height
        && manifest.suppressed_codes == suppressed_codes(config)?;
    let classifier = read_classifier(config, &manifest.styles)?;
    let same_styles = directory.style_classifier().is_ok_and(|known| known == classifier);
    let of = |entry: &str| manifest.training.get(entry);
    let made_of = of(CHECKPOINTS) == Some(&checkpoints(config)?);
    Ok(described && same_styles && made_of && of(SETTINGS) == Some(&settings(config)?))
}

/// Returns the weights of a finished run, and the pairs of codes that its training pieces begin
/// with.
///
/// # Errors
/// As [`export`].
pub fn trained_weights(
    config: &Config,
) -> Result<(VqVaeWeights, GptWeights, Vec<[u32; 2]>), TrainError> {
    let policy = Policy::latest(config)?;
    Ok((vqvae_weights(config)?, policy.weights(), policy.starts))
}

fn vqvae_weights(config: &Config) -> Result<VqVaeWeights, TrainError> {
    let frozen = FrozenVqVae::<Flex>::read(config, &FlexDevice)?.halves;
    let weights = motion_weights(config)?;
    let missing = || TrainError::LeftOut { what: "export", flag: "root_in_pose" };
    let half = |half: usize| HalfWeights {
        encoder: frozen.nets[half].encoder.weights(&frozen.store),
        codebook: weights.codebooks[half].clone(),
        decoder: weights.halves[half].clone(),
    };
    Ok(VqVaeWeights {
        upper: half(0),
        lower: half(1),
        root: weights.root.clone().ok_or_else(missing)?,
    })
}
