//! The stages that learn, and what each of them needs.

use super::{Config, Load, config::Keep};

/// A stage that learns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Both halves of the pose VQ-VAE.
    VqVae,
    /// The root's velocity.
    Velocity,
    /// The motion GPT.
    Gpt,
    /// The motion GPT's policy, by rewards of what it generates.
    ActorCritic,
}

impl Stage {
    /// Every stage of a whole run, in its order.
    pub const ALL: [Self; 4] = [Self::VqVae, Self::Velocity, Self::Gpt, Self::ActorCritic];

    /// Its name on the command line and in the run's folder.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::VqVae => "vqvae",
            Self::Velocity => "velocity",
            Self::Gpt => "gpt",
            Self::ActorCritic => "actor-critic",
        }
    }

    /// What it needs of the data.
    #[must_use]
    pub fn load(self) -> Load {
        match self {
            Self::VqVae | Self::Velocity => Load::Motion,
            Self::Gpt => Load::Music,
            Self::ActorCritic => Load::Songs,
        }
    }

    /// The stages whose weights it builds on.
    pub(super) fn bases(self, config: &Config) -> impl Iterator<Item = Self> {
        let bases: &[Self] = match self {
            Self::VqVae => &[],
            Self::Velocity | Self::Gpt => &[Self::VqVae],
            Self::ActorCritic => &[Self::VqVae, Self::Velocity, Self::Gpt],
        };
        bases.iter().copied().filter(|&base| config.has(base))
    }

    /// Which of its checkpoints is used afterwards.
    pub(super) fn keep(self, config: &Config) -> Keep {
        match self {
            Self::VqVae => config.vqvae.keep,
            Self::Velocity => config.velocity.keep,
            Self::Gpt => config.gpt.keep,
            Self::ActorCritic => Keep::Last,
        }
    }
}
