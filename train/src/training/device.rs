//! Devices, chosen at run time.

use std::{io::Write, path::Path};

use burn_autodiff::Autodiff;

use super::{
    Config, Limits, MotionSet, Outcome, TrainError, gpt::GptWork, runner::run,
    velocity::VelocityWork, vqvae::VqVaeWork,
};
use crate::nn::Trainable;

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

impl Stage {
    /// Its name on the command line, and of its folder.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::VqVae => "vqvae",
            Self::Velocity => "velocity",
            Self::Gpt => "gpt",
        }
    }
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
    match config.run.device.as_str() {
        "cpu" => on::<Autodiff<burn_flex::Flex>>(
            stage,
            config,
            set,
            init,
            limits,
            output,
            Default::default(),
        ),
        other => Err(TrainError::Device {
            device: other.to_owned(),
            message: "expected cpu, the only device of this version".to_owned(),
        }),
    }
}

fn on<A: Trainable>(
    stage: Stage,
    config: &Config,
    set: &MotionSet,
    init: Option<&Path>,
    limits: Limits,
    output: &mut impl Write,
    device: A::Device,
) -> Result<Outcome, TrainError> {
    match stage {
        Stage::VqVae => {
            let (plan, mut work) = VqVaeWork::<A>::new(config, set, init, &device)?;
            run::<A, _>(&plan, &mut work, &device, limits, output)
        }
        Stage::Velocity => {
            let (plan, mut work) = VelocityWork::<A>::new(config, set, &device)?;
            run::<A, _>(&plan, &mut work, &device, limits, output)
        }
        Stage::Gpt => {
            let (plan, mut work) = GptWork::<A>::new(config, set, init, &device, output)?;
            run::<A, _>(&plan, &mut work, &device, limits, output)
        }
    }
}
