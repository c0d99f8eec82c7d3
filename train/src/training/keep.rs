//! Which checkpoint of a finished stage is used, and what it was made of.

use std::{io, path::PathBuf};

use bailando::model::file_sha256;

use super::{
    Config, Stage, TrainError,
    config::Keep,
    runner::{checkpoint_path, stage_folder},
    saved::{Facts, Saved},
    state::other_settings,
};
use crate::nn::Precision;

/// The last state of a stage, from which it goes on.
pub(super) const CHECKPOINT_FILE: &str = "checkpoint.safetensors";
/// The weights with the lowest test loss.
pub(super) const BEST_FILE: &str = "best.safetensors";
/// Facts in a checkpoint.
pub(super) const SETTINGS: &str = "settings";
pub(super) const FINISHED: &str = "finished";
pub(super) const BEST_VALUE: &str = "best";
pub(super) const BEST_STEP: &str = "best_step";

fn finished_facts(config: &Config, stage: Stage) -> Result<Option<Facts>, TrainError> {
    let facts = Saved::read_facts(&checkpoint_path(&config.run, stage.name()))?;
    Ok(facts.filter(|facts| {
        facts
            .get(FINISHED)
            .is_some_and(|finished| finished == "true")
    }))
}

/// The file of a finished stage that later stages and the export take: as `use` says, but a stage
/// without a test split has no best one.
pub(super) fn kept_path(config: &Config, stage: Stage) -> Result<PathBuf, TrainError> {
    let name = stage.name();
    let path = checkpoint_path(&config.run, name);
    let Some(facts) = finished_facts(config, stage)? else {
        return Err(TrainError::StageMissing { stage: name, path });
    };
    if stage.keep(config) == Keep::Best && facts.contains_key(BEST_STEP) {
        return Ok(stage_folder(&config.run, name).join(BEST_FILE));
    }
    Ok(path)
}

/// That file's content.
pub(super) fn read_kept(config: &Config, stage: Stage) -> Result<(PathBuf, Saved), TrainError> {
    let path = kept_path(config, stage)?;
    let missing = || TrainError::StageMissing {
        stage: stage.name(),
        path: path.clone(),
    };
    let saved = Saved::read(&path)?.ok_or_else(missing)?;
    Ok((path, saved))
}

/// SHA-256 of that file.
pub(super) fn fingerprint(config: &Config, stage: Stage) -> Result<String, TrainError> {
    let path = kept_path(config, stage)?;
    let sum = || -> io::Result<String> { file_sha256(&mut std::fs::File::open(&path)?) };
    sum().map_err(TrainError::file(&path))
}

/// All that the weights of a stage depend on beside the data: its settings, and the weights of the
/// stages that it builds on. Which of its checkpoints is used afterwards is not part of that.
pub(super) fn settings(config: &Config, stage: Stage) -> Result<String, TrainError> {
    let own = match stage {
        Stage::VqVae => format!("{:?}", config.vqvae),
        Stage::Velocity => format!("{:?}", config.velocity),
        Stage::Gpt => format!("{:?}", config.gpt),
        Stage::ActorCritic => config.actor_critic.settings(),
    };
    let own = own.replace(&format!(", keep: {:?}", stage.keep(config)), "");
    let data = &config.data;
    let mut settings = format!(
        "{}seed {} frame {:?} mirror {} phases {} {:?} {own}, ",
        config.ablation.settings(stage),
        config.run.seed,
        data.frame,
        data.mirror,
        data.phases,
        data.profile,
    );
    if config.run.precision != Precision::F32 {
        settings.push_str(&format!("{:?} ", config.run.precision));
    }
    if matches!(stage, Stage::Gpt | Stage::ActorCritic) && !data.count_periods.is_empty() {
        settings.push_str(&format!("counts {:?} ", data.count_periods));
    }
    for base in stage.bases(config) {
        let sum = fingerprint(config, base)?;
        settings.push_str(&format!("{} {sum}, ", base.name()));
    }
    Ok(settings)
}

/// Whether a stage is finished, with the settings of now; the data are not looked at.
///
/// # Errors
/// [`TrainError::State`] if it is finished with others.
pub(super) fn is_finished(config: &Config, stage: Stage) -> Result<bool, TrainError> {
    let Some(facts) = finished_facts(config, stage)? else {
        return Ok(false);
    };
    let found = facts.get(SETTINGS).map_or("", String::as_str);
    if found.starts_with(&settings(config, stage)?) {
        return Ok(true);
    }
    Err(TrainError::State {
        path: checkpoint_path(&config.run, stage.name()),
        message: other_settings(found),
    })
}
