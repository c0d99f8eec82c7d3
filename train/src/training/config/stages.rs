//! Settings of each stage of training.

use bailando::model::MAX_CANDIDATES;
use serde::{Deserialize, Serialize};

use super::{
    balance::BalanceConfig,
    checks::{at_least_one, not_negative, within, within_range},
    optimiser::TrainingConfig,
};
use crate::{data::FRAMES_PER_CODE, training::reward::BeatReward};

/// Which weights of a finished stage are used afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CheckpointPolicy {
    /// Those of the last step.
    Last,
    /// Those with the lowest test loss.
    Best,
}

/// Stage `vqvae`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VqVaeConfig {
    pub width: usize,
    pub embedding: usize,
    pub codes: usize,
    pub frames: usize,
    pub stride: usize,
    pub velocity_weight: f64,
    pub acceleration_weight: f64,
    pub commitment: f64,
    pub decay: f64,
    pub restart_below: f64,
    pub contact_weight: f64,
    pub balance: BalanceConfig,
    pub training: TrainingConfig,
    #[serde(rename = "use")]
    pub checkpoint_policy: CheckpointPolicy,
}

impl VqVaeConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        at_least_one([
            ("width", self.width),
            ("embedding", self.embedding),
            ("codes", self.codes),
        ])?;
        not_negative([
            ("velocity_weight", self.velocity_weight),
            ("acceleration_weight", self.acceleration_weight),
            ("commitment", self.commitment),
            ("restart_below", self.restart_below),
            ("contact_weight", self.contact_weight),
        ])?;
        within("balance.", self.balance.check())?;
        within_range([("decay", self.decay)], 0.0..1.0, "0..1")?;
        check_crops(self.frames, self.stride)
    }
}

/// Stage `velocity`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VelocityConfig {
    pub frames: usize,
    pub stride: usize,
    pub difference_weight: f64,
    pub pose_decoders: bool,
    pub speed_weight: f64,
    pub contact_weight: f64,
    pub energy_weight: f64,
    pub balance: BalanceConfig,
    pub training: TrainingConfig,
    #[serde(rename = "use")]
    pub checkpoint_policy: CheckpointPolicy,
}

impl VelocityConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        not_negative([
            ("difference_weight", self.difference_weight),
            ("speed_weight", self.speed_weight),
            ("contact_weight", self.contact_weight),
            ("energy_weight", self.energy_weight),
        ])?;
        let of_joints =
            [("contact_weight", self.contact_weight), ("energy_weight", self.energy_weight)];
        if let Some((name, _)) = of_joints.iter().find(|(_, weight)| *weight > 0.0)
            && !self.pose_decoders
        {
            return Err(format!("{name} needs pose_decoders, which decode the joints"));
        }
        within("balance.", self.balance.check())?;
        check_crops(self.frames, self.stride)
    }
}

fn check_crops(frames: usize, stride: usize) -> Result<(), String> {
    if frames == 0 || !frames.is_multiple_of(FRAMES_PER_CODE) || stride == 0 {
        return Err(format!(
            "frames ({frames}) must be a multiple of {FRAMES_PER_CODE} and stride ({stride}) at \
             least 1"
        ));
    }
    Ok(())
}

/// Stage `gpt`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GptConfig {
    pub channels: usize,
    pub heads: usize,
    pub base_layers: usize,
    pub head_layers: usize,
    pub block: usize,
    pub stride: usize,
    pub phases: usize,
    pub dropout: f64,
    pub code_noise: f64,
    #[serde(rename = "slip_share")]
    pub shift_share: f64,
    #[serde(rename = "slip_frames")]
    pub shift_frames: usize,
    pub quantise_frames: usize,
    pub trim_still: bool,
    #[serde(rename = "hear")]
    pub music_columns: MusicColumns,
    pub standardise_music: bool,
    pub styles: bool,
    pub energy: bool,
    pub style_drop: f64,
    pub recombine: f64,
    pub balance: BalanceConfig,
    pub training: TrainingConfig,
    #[serde(rename = "use")]
    pub checkpoint_policy: CheckpointPolicy,
}

impl GptConfig {
    /// `phases`: those of the data.
    pub(super) fn check(&self, phases: usize) -> Result<(), String> {
        let Self { channels, heads, .. } = self;
        at_least_one([
            ("channels", *channels),
            ("block", self.block),
            ("stride", self.stride),
            ("base_layers", self.base_layers),
        ])?;
        if *heads == 0 || !channels.is_multiple_of(*heads) {
            return Err(format!("channels ({channels}) cannot be divided among {heads} heads"));
        }
        if self.phases > phases {
            let asked = self.phases;
            return Err(format!("phases ({asked}) must lie in 0..={phases}, the phases of [data]"));
        }
        let shares = [("dropout", self.dropout), ("code_noise", self.code_noise)];
        within_range(shares, 0.0..1.0, "0..1")?;
        let shares = [
            ("slip_share", self.shift_share),
            ("style_drop", self.style_drop),
            ("recombine", self.recombine),
        ];
        within_range(shares, 0.0..=1.0, "0..=1")?;
        within("balance.", self.balance.check())?;
        if self.shift_share > 0.0 && self.shift_frames == 0 {
            return Err("slip_frames must be at least 1 where slip_share is not 0".into());
        }
        Ok(())
    }
}

/// Which music columns the GPT is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MusicColumns {
    /// All, as published.
    All,
    /// Onsets, beats and counts. Timbre and harmony identify the few training songs, and a new
    /// song is like none of them.
    Rhythm,
}

/// Stage `actor-critic`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActorCriticConfig {
    pub enabled: bool,
    pub critic_layers: usize,
    pub reward: BeatReward,
    pub beat_weight: f64,
    pub consistency_weight: f64,
    pub slow_weight: f64,
    pub speed_weight: f64,
    pub discount: f64,
    pub trace: f64,
    pub reward_lead: usize,
    pub standardise_advantage: bool,
    pub entropy_weight: f64,
    pub divergence_weight: f64,
    pub free_steps: u64,
    pub gains_only: bool,
    pub temperature: f64,
    pub pieces_per_epoch: usize,
    pub takes: usize,
    pub continued: f64,
    pub codes: usize,
    pub actor_steps: u64,
    pub critic_steps: u64,
    pub critic_warmup_steps: u64,
    pub critic_rate_factor: f64,
    pub kept: f64,
    pub training: TrainingConfig,
}

impl ActorCriticConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        if self.actor_steps == 0 {
            return Err("actor_steps must be at least 1".into());
        }
        at_least_one([("critic_layers", self.critic_layers), ("takes", self.takes)])?;
        let shares = [("continued", self.continued), ("kept", self.kept)];
        within_range(shares, 0.0..=1.0, "0..=1")?;
        not_negative([
            ("beat_weight", self.beat_weight),
            ("consistency_weight", self.consistency_weight),
            ("slow_weight", self.slow_weight),
            ("speed_weight", self.speed_weight),
            ("critic_rate_factor", self.critic_rate_factor),
            ("discount", self.discount),
            ("trace", self.trace),
            ("entropy_weight", self.entropy_weight),
            ("divergence_weight", self.divergence_weight),
            ("temperature", self.temperature),
        ])
    }
}

/// Stage `adapt`; what is not said here is as in `actor_critic`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdaptConfig {
    pub candidates: usize,
    pub dances: usize,
    pub stride: usize,
    pub divergence_weight: f64,
    pub pieces_per_epoch: usize,
    pub codes: usize,
    pub training: TrainingConfig,
}

impl AdaptConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        let Self { candidates, .. } = self;
        if *candidates > MAX_CANDIDATES {
            return Err(format!("candidates ({candidates}) must lie in 0..={MAX_CANDIDATES}"));
        }
        not_negative([("divergence_weight", self.divergence_weight)])?;
        at_least_one([
            ("pieces_per_epoch", self.pieces_per_epoch),
            ("dances", self.dances),
            ("stride", self.stride),
        ])
    }
}
