//! Devices, chosen at run time.

use std::{io::Write, path::Path};

use burn_autodiff::Autodiff;
use burn_tensor::backend::AutodiffBackend;

use super::{
    Config, Limits, MotionSet, Outcome, Song, TrainError,
    actor_critic::{ActorCriticWork, Task},
    decode::DanceDecoder,
    gpt::GptWork,
    policy::Policy,
    rollout::judge,
    runner::run,
    velocity::VelocityWork,
    vqvae::VqVaeWork,
};

/// A stage that learns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Both halves of the pose VQ-VAE.
    VqVae,
    /// The root's velocity.
    Velocity,
    /// The motion GPT.
    Gpt,
}

/// Runs a stage on the device that the configuration names. `init` is an official checkpoint to
/// start from; `velocity` has none.
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
    let job = StageJob {
        stage,
        config,
        set,
        init,
        limits,
        output,
    };
    on_device(&config.run.device, job)
}

/// Runs stage `actor-critic` on the songs of the training split. `init` is an official checkpoint
/// whose critic is the first; the policy is that of the finished `gpt`.
///
/// # Errors
/// Any [`TrainError`]; the last checkpoint stays.
pub fn actor_critic(
    config: &Config,
    songs: &[Song],
    init: Option<&Path>,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    let task = Task {
        name: "actor-critic",
        run: &config.run,
        stage: &config.actor_critic,
        policy: Policy::of_gpt(config)?,
        init,
        songs,
    };
    learn_from_rewards(config, task, limits, output)
}

/// The task of either stage that learns from rewards, on the configured device.
pub(super) fn learn_from_rewards(
    config: &Config,
    task: Task<'_>,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    let job = RewardJob {
        config,
        task,
        limits,
        output,
    };
    on_device(&config.run.device, job)
}

/// What is to be done on whichever device.
trait Job {
    fn run_on<A: AutodiffBackend>(self, device: &A::Device) -> Result<Outcome, TrainError>;
}

fn on_device(name: &str, job: impl Job) -> Result<Outcome, TrainError> {
    match name {
        "cpu" => job.run_on::<Autodiff<burn_flex::Flex>>(&Default::default()),
        other => Err(TrainError::Device {
            device: other.to_owned(),
            message: "expected cpu, the only device of this version".to_owned(),
        }),
    }
}

struct StageJob<'a, O> {
    stage: Stage,
    config: &'a Config,
    set: &'a MotionSet,
    init: Option<&'a Path>,
    limits: Limits,
    output: &'a mut O,
}

impl<O: Write> Job for StageJob<'_, O> {
    fn run_on<A: AutodiffBackend>(self, device: &A::Device) -> Result<Outcome, TrainError> {
        let (config, set, init) = (self.config, self.set, self.init);
        match self.stage {
            Stage::VqVae => {
                let (plan, mut work) = VqVaeWork::<A>::new(config, set, init, device)?;
                run::<A, _>(&plan, &mut work, device, self.limits, self.output)
            }
            Stage::Velocity => {
                let (plan, mut work) = VelocityWork::<A>::new(config, set, device)?;
                run::<A, _>(&plan, &mut work, device, self.limits, self.output)
            }
            Stage::Gpt => {
                let (plan, mut work) = GptWork::<A>::new(config, set, init, device)?;
                run::<A, _>(&plan, &mut work, device, self.limits, self.output)
            }
        }
    }
}

struct RewardJob<'a, O> {
    config: &'a Config,
    task: Task<'a>,
    limits: Limits,
    output: &'a mut O,
}

impl<O: Write> Job for RewardJob<'_, O> {
    fn run_on<A: AutodiffBackend>(self, device: &A::Device) -> Result<Outcome, TrainError> {
        let decoder = DanceDecoder::<A::InnerBackend>::read(self.config, device)?;
        let judge = judge(decoder, self.task.stage.rule());
        let (plan, mut work) = ActorCriticWork::<A>::new(self.config, self.task, judge, device)?;
        run::<A, _>(&plan, &mut work, device, self.limits, self.output)
    }
}
