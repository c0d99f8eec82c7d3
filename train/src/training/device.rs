//! Devices, chosen at run time.

use std::{io::Write, path::Path};

use bailando::motion::Positions;
use burn_autodiff::Autodiff;

use super::{
    Config, Limits, MotionSet, Outcome, Stage, TrainError,
    actor_critic::{ActorCriticWork, Task},
    decode::DanceDecoder,
    generate::{TestPiece, dances},
    gpt::GptWork,
    policy::Policy,
    rollout::judge,
    runner::run,
    velocity::VelocityWork,
    vqvae::VqVaeWork,
};
use crate::nn::Trainable;

/// Runs a stage on the device that the configuration names. `init` is an official checkpoint to
/// start from; `velocity` has none, and for `actor-critic` it gives the critic alone.
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
    if !config.has(stage) && stage == Stage::Velocity {
        return Err(TrainError::LeftOut {
            what: "velocity",
            flag: "root_in_pose",
        });
    }
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

/// Dances for pieces of the test split, on the configured device.
pub(super) fn generate_on_device(
    config: &Config,
    policy: &Policy,
    pieces: &[TestPiece],
    seed: u64,
) -> Result<Vec<Option<Positions>>, TrainError> {
    let job = DanceJob {
        config,
        policy,
        pieces,
        seed,
    };
    on_device(&config.run.device, job)
}

/// What is to be done on whichever device.
trait Job {
    type Done;
    fn run_on<A: Trainable>(self, device: &A::Device) -> Result<Self::Done, TrainError>;
}

fn on_device<J: Job>(name: &str, job: J) -> Result<J::Done, TrainError> {
    let unknown = |message: &str| TrainError::Device {
        device: name.to_owned(),
        message: message.to_owned(),
    };
    match name {
        "cpu" => job.run_on::<Autodiff<burn_flex::Flex>>(&Default::default()),
        #[cfg(feature = "cuda")]
        "cuda" => guarded(name, || {
            job.run_on::<Autodiff<burn_cuda::Cuda>>(&Default::default())
        }),
        #[cfg(feature = "libtorch")]
        "libtorch" => guarded(name, || {
            let device = match tch::Cuda::is_available() {
                true => burn_tch::LibTorchDevice::Cuda(0),
                false => burn_tch::LibTorchDevice::Cpu,
            };
            job.run_on::<Autodiff<burn_tch::LibTorch>>(&device)
        }),
        #[cfg(feature = "wgpu")]
        "wgpu" => guarded(name, || {
            job.run_on::<Autodiff<burn_wgpu::Wgpu>>(&Default::default())
        }),
        #[allow(unreachable_patterns, reason = "a build may have any")]
        "cuda" | "libtorch" | "wgpu" => Err(unknown(&format!(
            "not in this build: cargo build --release -p bailando-train --features {name}"
        ))),
        _ => Err(unknown("expected cpu, cuda, libtorch or wgpu")),
    }
}

/// An accelerator's library panics where there is no driver: that is an error like any other.
#[cfg(any(feature = "cuda", feature = "libtorch", feature = "wgpu"))]
fn guarded<T>(device: &str, job: impl FnOnce() -> Result<T, TrainError>) -> Result<T, TrainError> {
    let run = std::panic::AssertUnwindSafe(job);
    std::panic::catch_unwind(run).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
        Err(TrainError::Device {
            device: device.to_owned(),
            message: format!("failed: {}", text.unwrap_or("no reason given")),
        })
    })
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
    type Done = Outcome;

    fn run_on<A: Trainable>(self, device: &A::Device) -> Result<Outcome, TrainError> {
        let (config, set, init) = (self.config, self.set, self.init);
        let (limits, output) = (self.limits, self.output);
        match self.stage {
            Stage::VqVae => {
                let (plan, mut work) = VqVaeWork::<A>::new(config, set, init, device)?;
                run::<A, _>(&plan, &mut work, device, limits, output)
            }
            Stage::Velocity => {
                let (plan, mut work) = VelocityWork::<A>::new(config, set, device)?;
                run::<A, _>(&plan, &mut work, device, limits, output)
            }
            Stage::Gpt => {
                let (plan, mut work) = GptWork::<A>::new(config, set, init, device, output)?;
                run::<A, _>(&plan, &mut work, device, limits, output)
            }
            Stage::ActorCritic => {
                let job = RewardJob {
                    config,
                    task: Task::of_run(config, &set.songs, init)?,
                    limits,
                    output,
                };
                job.run_on::<A>(device)
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
    type Done = Outcome;

    fn run_on<A: Trainable>(self, device: &A::Device) -> Result<Outcome, TrainError> {
        let decoder = DanceDecoder::<A::InnerBackend>::read(self.config, device)?;
        let judge = judge(decoder, self.task.stage.rule());
        let (plan, mut work) = ActorCriticWork::<A>::new(self.config, self.task, judge, device)?;
        run::<A, _>(&plan, &mut work, device, self.limits, self.output)
    }
}

struct DanceJob<'a> {
    config: &'a Config,
    policy: &'a Policy,
    pieces: &'a [TestPiece],
    seed: u64,
}

impl Job for DanceJob<'_> {
    type Done = Vec<Option<Positions>>;

    fn run_on<A: Trainable>(self, device: &A::Device) -> Result<Self::Done, TrainError> {
        dances::<A::InnerBackend>(self.config, self.policy, self.pieces, self.seed, device)
    }
}
