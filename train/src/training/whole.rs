//! A whole run: every stage in order, then the model directory.

use std::{io::Write, path::Path, time::Instant};

use super::{
    config::Config,
    error::TrainError,
    export::{export, is_exported},
    identity::is_finished,
    input::MotionSet,
    policy::Policy,
    runner::{Limits, Outcome},
    song_styles::{learn_styles, read_classifier},
    stage::{Load, Stage},
    train::train,
};
use crate::export::check_target;

/// Runs all stages from their checkpoints, then the export. Finished stages, and a model that is
/// made of them, stay as they are, with one line on `output`.
///
/// `init` is a model directory that the stages before the rewards start from. `replace` allows
/// another model to be replaced; without it a model that is in the way stops the run before hours
/// are spent. `limits.seconds` limits all stages together, `limits.steps` each of them.
///
/// # Errors
/// Any [`TrainError`]; the last checkpoint stays.
pub fn run_all(
    config: &Config,
    replace: bool,
    init: Option<&Path>,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    let mut known = None;
    // As for a single stage, reading is not counted: every call gets some steps done.
    let mut spent = 0.0;
    for stage in Stage::ALL.into_iter().filter(|stage| stage.is_part_of(config)) {
        if is_finished(config, stage)? {
            tell(output, &format!("{}: finished before", stage.name()));
            continue;
        }
        if config.ablation.flag().is_none() {
            check_target(&config.export.folder, replace)?;
        }
        let set = read_once(&mut known, stage.load(), config, output)?;
        let limits = Limits { seconds: limits.seconds.map(|most| most - spent), ..limits };
        let start = Instant::now();
        let init = init.filter(|_| stage != Stage::ActorCritic);
        if train(stage, config, set, init, limits, output)? == Outcome::Paused {
            return Ok(Outcome::Paused);
        }
        spent += start.elapsed().as_secs_f64();
    }
    if config.ablation.flag().is_some() {
        tell(output, "export: left out, as parts of the model are ([ablation])");
        return Ok(Outcome::Finished);
    }
    if config.gpt.styles
        && read_classifier(config, &Policy::latest(config)?.manners.styles)?.is_none()
    {
        let report = learn_styles(config, output)?;
        tell(output, &format!("styles of songs:\n{report}"));
    }
    let folder = config.export.folder.display();
    if !replace && is_exported(config)? {
        let line = format!("export: {folder} is made of these stages already");
        tell(output, &line);
    } else {
        let manifest = export(config, replace)?;
        let line = format!("export: wrote {folder} ({})", manifest.name);
        tell(output, &line);
    }
    Ok(Outcome::Finished)
}

/// Returns the data set of a stage. Stages with the same needs share one: where music is not
/// needed, more motions count.
fn read_once<'a>(
    known: &'a mut Option<(Load, MotionSet)>,
    load: Load,
    config: &Config,
    output: &mut impl Write,
) -> Result<&'a MotionSet, TrainError> {
    let (_, set) = match known.take() {
        Some(same) if same.0 == load => known.insert(same),
        _ => known.insert((load, MotionSet::read(config, load, output)?)),
    };
    Ok(set)
}

/// Writes a line; an output that is closed is no reason to stop.
fn tell(output: &mut impl Write, line: &str) {
    let _ = writeln!(output, "{line}");
}
