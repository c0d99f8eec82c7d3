//! One stage on the configured device.

use std::{io::Write, path::Path};

use super::{
    actor_critic::{RewardTask, learn_from_rewards},
    config::Config,
    device::on_device,
    error::TrainError,
    gpt::GptStage,
    input::MotionSet,
    runner::{Limits, Outcome, run},
    stage::Stage,
    velocity::VelocityStage,
    vqvae::VqVaeStage,
};

/// Runs a stage on the device that the configuration names. `init` is what it starts from: a model
/// directory, or an official checkpoint; `velocity` takes a directory alone, `actor-critic` a
/// checkpoint's critic alone.
///
/// # Errors
/// Any [`TrainError`]; the last checkpoint stays.
pub fn train(
    stage: Stage,
    config: &Config,
    set: &MotionSet,
    init: Option<&Path>,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    if stage == Stage::Velocity && !stage.is_part_of(config) {
        return Err(TrainError::LeftOut { what: "velocity", flag: "root_in_pose" });
    }
    on_device!(config.run.device.as_str(), |A, device| match stage {
        Stage::VqVae => {
            let (spec, mut stage) = VqVaeStage::<A>::new(config, set, init, &device)?;
            run(&spec, &mut stage, &device, limits, output)
        }
        Stage::Velocity => {
            let (spec, mut stage) = VelocityStage::<A>::new(config, set, init, &device)?;
            run(&spec, &mut stage, &device, limits, output)
        }
        Stage::Gpt => {
            let (spec, mut stage) = GptStage::<A>::new(config, set, init, &device, output)?;
            run(&spec, &mut stage, &device, limits, output)
        }
        Stage::ActorCritic => {
            let task = RewardTask::of_run(config, &set.songs, init)?;
            learn_from_rewards::<A>(config, task, &device, limits, output)
        }
    })
}
