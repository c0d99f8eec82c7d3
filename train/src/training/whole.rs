//! A whole run: every stage in order, then the model directory.

use std::{io::Write, time::Instant};

use super::{
    Config, Limits, MotionSet, Outcome, Stage, TrainError, export, export::is_exported,
    keep::is_finished, train,
};
use crate::export::check_target;

/// Runs all stages from where they are, then the export. Stages that are finished, and a model
/// made of them, are left alone with one line on `output`.
///
/// `replace` allows another model to be replaced; without it a model that is in the way stops the
/// run before hours are spent. `seconds` limits all stages together.
///
/// # Errors
/// Any [`TrainError`]; the last checkpoint stays.
pub fn run_all(
    config: &Config,
    replace: bool,
    seconds: Option<f64>,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    let mut set = None;
    let mut start = Instant::now();
    let wanted = |stage: &Stage| *stage != Stage::ActorCritic || config.actor_critic.enabled;
    for stage in Stage::ALL.into_iter().filter(wanted) {
        if is_finished(config, stage)? {
            tell(output, &format!("{}: finished before", stage.name()));
            continue;
        }
        let load = stage.load();
        let set = match &set {
            Some((loaded, set)) if *loaded == load => set,
            _ => {
                check_target(&config.export.folder, replace)?;
                let reading = Instant::now();
                let read = MotionSet::read(&config.data, load, output)?;
                // As for a single stage, reading is not counted: every call gets some steps done.
                start += reading.elapsed();
                &set.insert((load, read)).1
            }
        };
        let limits = Limits {
            seconds: seconds.map(|most| most - start.elapsed().as_secs_f64()),
            steps: None,
        };
        if train(stage, config, set, None, limits, output)? == Outcome::Paused {
            return Ok(Outcome::Paused);
        }
    }
    let folder = config.export.folder.display();
    if !replace && is_exported(config)? {
        tell(
            output,
            &format!("export: {folder} is made of these stages already"),
        );
    } else {
        let manifest = export(config, replace)?;
        tell(
            output,
            &format!("export: wrote {folder} ({})", manifest.name),
        );
    }
    Ok(Outcome::Finished)
}

/// A line that nobody can read is no reason to stop.
fn tell(output: &mut impl Write, line: &str) {
    let _ = writeln!(output, "{line}");
}
