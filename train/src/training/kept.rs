//! Where checkpoints of a run lie, which stages are finished, and which of their files are used.

use std::{
    fs::File,
    io,
    path::{Path, PathBuf},
    str::FromStr,
};

use bailando::model::file_sha256;

use super::{
    checkpoint::{Checkpoint, Facts},
    config::{CheckpointPolicy, Config, RunConfig, TrainingConfig},
    error::TrainError,
    stage::Stage,
};

/// Prefix of the weights in a stage's checkpoint.
pub(super) const WEIGHT: &str = "weight.";
/// The last state of a stage, from which it resumes.
pub(super) const CHECKPOINT_FILE: &str = "checkpoint.safetensors";
/// The weights with the lowest test loss.
pub(super) const BEST_FILE: &str = "best.safetensors";
/// Facts in a checkpoint.
pub(super) const STEP: &str = "step";
pub(super) const WINDOWS: &str = "windows";
pub(super) const BEST_VALUE: &str = "best";
pub(super) const BEST_STEP: &str = "best_step";

/// Returns the folder of a stage.
pub(super) fn stage_folder(run: &RunConfig, stage: &str) -> PathBuf {
    run.folder.join(stage)
}

/// Returns the path of a stage's checkpoint.
pub(super) fn checkpoint_path(run: &RunConfig, stage: &str) -> PathBuf {
    stage_folder(run, stage).join(CHECKPOINT_FILE)
}

/// Parses a fact.
pub(super) fn parsed<T: FromStr>(facts: &Facts, name: &str) -> Result<T, String> {
    let value = facts.get(name).and_then(|text| text.parse().ok());
    value.ok_or_else(|| {
        format!("was made by another version (`{name}`): use another run.folder, or delete it")
    })
}

/// Whether a checkpoint has all the steps that the settings ask for. Asking for more later makes
/// a finished stage unfinished, and it resumes.
pub(super) fn has_all_steps(facts: &Facts, training: &TrainingConfig) -> Result<bool, String> {
    let (step, windows) = (parsed::<u64>(facts, STEP)?, parsed(facts, WINDOWS)?);
    let total = training.total_steps(windows);
    match step > total {
        true => Err(format!(
            "has done {step} steps, more than the {total} that its settings ask for: raise steps \
             (or epochs), or use another run.folder"
        )),
        false => Ok(step == total),
    }
}

/// Reads the facts of a stage's checkpoint, if it is finished.
fn finished_facts(path: &Path, training: &TrainingConfig) -> Result<Option<Facts>, TrainError> {
    let Some(facts) = Checkpoint::read_facts(path)? else {
        return Ok(None);
    };
    let finished = has_all_steps(&facts, training).map_err(TrainError::state(path))?;
    Ok(finished.then_some(facts))
}

/// Reads the facts of a finished stage of a run; `None` where it is missing or not finished.
pub(super) fn facts_of(config: &Config, stage: Stage) -> Result<Option<Facts>, TrainError> {
    let path = checkpoint_path(&config.run, stage.name());
    finished_facts(&path, stage.training(config))
}

/// Reads the last checkpoint of a finished stage in any folder.
pub(super) fn read_finished(
    run: &RunConfig,
    stage: &'static str,
    training: &TrainingConfig,
) -> Result<Checkpoint, TrainError> {
    let path = checkpoint_path(run, stage);
    let checkpoint = match finished_facts(&path, training)? {
        Some(_) => Checkpoint::read(&path)?,
        None => None,
    };
    checkpoint.ok_or(TrainError::StageMissing { stage, path })
}

/// Returns the file of a finished stage that later stages and the export take: as `use` says, but
/// a stage without a test split has no best one.
pub(super) fn kept_path(config: &Config, stage: Stage) -> Result<PathBuf, TrainError> {
    let name = stage.name();
    let path = checkpoint_path(&config.run, name);
    let Some(facts) = facts_of(config, stage)? else {
        return Err(TrainError::StageMissing { stage: name, path });
    };
    let best = stage.checkpoint_policy(config) == CheckpointPolicy::Best;
    if best && facts.contains_key(BEST_STEP) {
        return Ok(stage_folder(&config.run, name).join(BEST_FILE));
    }
    Ok(path)
}

/// Reads that file.
pub(super) fn read_kept(
    config: &Config,
    stage: Stage,
) -> Result<(PathBuf, Checkpoint), TrainError> {
    let path = kept_path(config, stage)?;
    let missing = || TrainError::StageMissing { stage: stage.name(), path: path.clone() };
    let checkpoint = Checkpoint::read(&path)?.ok_or_else(missing)?;
    Ok((path, checkpoint))
}

/// Returns the SHA-256 of that file.
pub(super) fn fingerprint(config: &Config, stage: Stage) -> Result<String, TrainError> {
    let path = kept_path(config, stage)?;
    let sum = || -> io::Result<String> { file_sha256(&mut File::open(&path)?) };
    sum().map_err(TrainError::file(&path))
}
