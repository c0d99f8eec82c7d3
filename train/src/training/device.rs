//! Devices, chosen at run time.

use std::{io::Write, path::Path};

use burn_autodiff::Autodiff;

use super::{
    Config, Limits, Load, MotionSet, Outcome, TrainError, config::Keep, gpt::GptWork, runner::run,
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
    /// Every stage of a whole run, in its order.
    pub const ALL: [Self; 3] = [Self::VqVae, Self::Velocity, Self::Gpt];

    /// Its name on the command line and in the run's folder.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::VqVae => "vqvae",
            Self::Velocity => "velocity",
            Self::Gpt => "gpt",
        }
    }

    /// What it needs of the data.
    #[must_use]
    pub fn load(self) -> Load {
        match self {
            Self::VqVae | Self::Velocity => Load::Motion,
            Self::Gpt => Load::Music,
        }
    }

    /// The stages whose weights it builds on.
    pub(super) fn bases(self) -> &'static [Self] {
        match self {
            Self::VqVae => &[],
            Self::Velocity | Self::Gpt => &[Self::VqVae],
        }
    }

    /// Which of its checkpoints is used afterwards.
    pub(super) fn keep(self, config: &Config) -> Keep {
        match self {
            Self::VqVae => config.vqvae.keep,
            Self::Velocity => config.velocity.keep,
            Self::Gpt => config.gpt.keep,
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
