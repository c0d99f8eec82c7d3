//! Stage `export`: the trained parts as a model directory.

use std::collections::BTreeMap;

use bailando::model::{Manifest, ModelDirectory};
use burn_flex::{Flex, FlexDevice};
use serde_json::Value;

use super::{
    Config, Stage, TrainError,
    gpt::{MusicScale, random},
    keep::{fingerprint, kept_path, read_kept},
    runner::WEIGHT,
    saved::Saved,
    velocity::root,
    vqvae::Trained,
};
use crate::{
    export::{Description, write_model_directory},
    nn::{GptNet, Store},
    weights::{GptWeights, HalfWeights, VqVaeWeights},
};

/// Entry of the manifest's `training`.
const CHECKPOINTS: &str = "checkpoints";

/// Writes the model directory of a finished run.
///
/// # Errors
/// [`TrainError::StageMissing`] where a stage is not finished; what cannot be read or written.
pub fn export(config: &Config, replace: bool) -> Result<Manifest, TrainError> {
    let (vqvae, gpt, start_codes) = trained_weights(config)?;
    let training = [
        ("seed", config.run.seed.into()),
        ("data", config.data.folder.display().to_string().into()),
        (CHECKPOINTS, checkpoints(config)?),
    ];
    let description = Description {
        name: config.export.name.clone(),
        licence: config.export.licence.clone(),
        profile: config.data.profile,
        start_codes,
        temperature: config.export.temperature,
        motion_frame: config.data.frame,
        root_height: config.export.root_height,
        weights: config.export.weights,
        training: BTreeMap::from(training.map(|(name, value)| (name.to_owned(), value))),
    };
    let folder = &config.export.folder;
    Ok(write_model_directory(
        folder,
        replace,
        &gpt,
        &vqvae,
        &description,
    )?)
}

/// SHA-256 of the file that each stage contributes.
fn checkpoints(config: &Config) -> Result<Value, TrainError> {
    let sum = |stage: Stage| Ok((stage.name().to_owned(), fingerprint(config, stage)?.into()));
    let sums: Result<_, TrainError> = Stage::ALL.into_iter().map(sum).collect();
    Ok(Value::Object(sums?))
}

/// Whether the model directory is there and made of the stages as they are.
pub(super) fn is_exported(config: &Config) -> Result<bool, TrainError> {
    let Ok(directory) = ModelDirectory::open(&config.export.folder) else {
        return Ok(false);
    };
    let made_of = directory.manifest().training.get(CHECKPOINTS);
    Ok(made_of == Some(&checkpoints(config)?))
}

/// The weights of a finished run, and the pairs of codes that its training pieces begin with.
///
/// # Errors
/// As [`export`].
pub fn trained_weights(
    config: &Config,
) -> Result<(VqVaeWeights, GptWeights, Vec<[u32; 2]>), TrainError> {
    let trained = Trained::<Flex>::read(config, &FlexDevice)?;
    let store = &trained.halves.store;
    let [upper_net, lower_net] = &trained.halves.nets;
    let [upper_codes, lower_codes] = &trained.codebooks;
    let half = |net: &crate::nn::HalfNet, codes: &crate::nn::Codebook<Flex>| {
        let [entries, ..] = codes.state();
        HalfWeights {
            encoder: net.encoder.weights(store),
            codebook: entries,
            decoder: net.decoder.weights(store),
        }
    };
    let (root, root_store) = root(config);
    let (_, root_store) = finished(config, Stage::Velocity, |_| Ok(root_store))?;
    let vqvae = VqVaeWeights {
        upper: half(upper_net, upper_codes),
        lower: half(lower_net, lower_codes),
        root: root.weights(&root_store),
    };
    let mut net = None;
    let (saved, store) = finished(config, Stage::Gpt, |saved| {
        let mut store = Store::default();
        let columns = saved.tensor("music.mean")?.dim(0);
        net = Some(GptNet::new(&random(config, columns), &mut store));
        Ok(store)
    })?;
    let path = kept_path(config, Stage::Gpt)?;
    let failed = |message: String| TrainError::State {
        path: path.clone(),
        message,
    };
    let net = net.ok_or_else(|| failed("no network".into()))?;
    let mut gpt = net.weights(&store);
    let column = |name| {
        saved
            .tensor(name)
            .map(|tensor| tensor.data().to_vec())
            .map_err(failed)
    };
    let scale = MusicScale {
        mean: column("music.mean")?,
        spread: column("music.spread")?,
    };
    gpt.music = scale.fold(&gpt.music);
    let starts = column("start_codes")?;
    let pairs = starts.as_chunks::<2>().0.iter();
    let pairs = pairs.map(|pair| pair.map(|code| code as u32)).collect();
    Ok((vqvae, gpt, pairs))
}

/// What a finished stage keeps, and its weights in the shape of a plan.
fn finished(
    config: &Config,
    stage: Stage,
    plan: impl FnOnce(&Saved) -> Result<Store, String>,
) -> Result<(Saved, Store), TrainError> {
    let (path, saved) = read_kept(config, stage)?;
    let store = plan(&saved).and_then(|store| saved.fill(WEIGHT, &store));
    let store = store.map_err(|message| TrainError::State { path, message })?;
    Ok((saved, store))
}
