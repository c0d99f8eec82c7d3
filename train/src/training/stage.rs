//! The stages that learn, and what each of them needs.

use super::config::{CheckpointPolicy, Config, TrainingConfig};

/// A stage that learns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Both halves of the pose VQ-VAE.
    VqVae,
    /// The root's velocity.
    Velocity,
    /// The motion GPT.
    Gpt,
    /// The motion GPT's policy, by rewards of generated motion.
    ActorCritic,
}

/// What is needed of a data folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Load {
    /// Motions alone.
    Motion,
    /// Motions that have music, and the songs' features; progress is reported.
    Music,
    /// The training songs and their beats, for rewards; and motions alone.
    Songs,
}

impl Stage {
    /// Every stage of a whole run, in its order.
    pub const ALL: [Self; 4] = [Self::VqVae, Self::Velocity, Self::Gpt, Self::ActorCritic];

    /// Returns its name on the command line and in the run's folder.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::VqVae => "vqvae",
            Self::Velocity => "velocity",
            Self::Gpt => "gpt",
            Self::ActorCritic => "actor-critic",
        }
    }

    /// Returns what it needs of the data.
    #[must_use]
    pub fn load(self) -> Load {
        match self {
            Self::VqVae | Self::Velocity => Load::Motion,
            Self::Gpt => Load::Music,
            Self::ActorCritic => Load::Songs,
        }
    }

    /// Whether a run has this stage.
    pub(super) fn is_part_of(self, config: &Config) -> bool {
        match self {
            Self::Velocity => !config.ablation.root_in_pose,
            Self::ActorCritic => config.actor_critic.enabled,
            Self::VqVae | Self::Gpt => true,
        }
    }

    /// Returns the stages whose weights it builds on.
    pub(super) fn bases(self, config: &Config) -> impl Iterator<Item = Self> {
        let bases: &[Self] = match self {
            Self::VqVae => &[],
            Self::Velocity | Self::Gpt => &[Self::VqVae],
            Self::ActorCritic => &[Self::VqVae, Self::Velocity, Self::Gpt],
        };
        bases.iter().copied().filter(|base| base.is_part_of(config))
    }

    /// Returns its length and optimiser.
    pub(super) fn training(self, config: &Config) -> &TrainingConfig {
        match self {
            Self::VqVae => &config.vqvae.training,
            Self::Velocity => &config.velocity.training,
            Self::Gpt => &config.gpt.training,
            Self::ActorCritic => &config.actor_critic.training,
        }
    }

    /// Returns which of its checkpoints is used afterwards.
    pub(super) fn checkpoint_policy(self, config: &Config) -> CheckpointPolicy {
        match self {
            Self::VqVae => config.vqvae.checkpoint_policy,
            Self::Velocity => config.velocity.checkpoint_policy,
            Self::Gpt => config.gpt.checkpoint_policy,
            Self::ActorCritic => CheckpointPolicy::Last,
        }
    }
}
