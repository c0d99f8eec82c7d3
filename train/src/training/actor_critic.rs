//! Stage `actor-critic`: the policy learns from the rewards of what it generates, beside a critic
//! (paper section 3.3, Eq. 7-11; ARCHITECTURE section 6). State network and VQ-VAE are frozen.

use std::{io::Write, path::Path};

use burn_tensor::Tensor;

use super::{
    checkpoint::Checkpoint,
    config::{ActorCriticConfig, Config, RunConfig},
    decode::{MotionDecoder, motion_weights},
    error::TrainError,
    identity::Identity,
    policy::{Policy, first_critic},
    reward::RewardRule,
    rollout::{RewardFn, Rollout, RolloutPlan, reward_fn},
    runner::{Limits, Outcome, run},
    sampling::Sampler,
    song::Song,
    stage::Stage,
    trainable::{Losses, StageSpec, TrainableStage},
    trajectory_batch::TrajectoryBatch,
};
use crate::{
    checkpoint::TorchCheckpoint,
    nn::{CriticNet, Parameters, Store, Trainable},
    weights::{CriticWeights, MotionWeights},
};

/// What a stage that learns from rewards starts from.
pub(super) struct RewardTask<'a> {
    pub(super) name: &'static str,
    /// Everything that its result depends on.
    pub(super) identity: Identity,
    pub(super) run: &'a RunConfig,
    pub(super) stage: &'a ActorCriticConfig,
    /// The policy that learns.
    pub(super) policy: Policy,
    /// What turns its codes into motion.
    pub(super) motion: MotionWeights,
    /// An official checkpoint whose critic is the first.
    pub(super) init: Option<&'a Path>,
    /// The songs that it generates motion for.
    pub(super) songs: &'a [Song],
}

impl<'a> RewardTask<'a> {
    /// Returns the task of a run: the policy of its finished `gpt` on the songs of the training
    /// split.
    pub(super) fn of_run(
        config: &'a Config,
        songs: &'a [Song],
        init: Option<&'a Path>,
    ) -> Result<Self, TrainError> {
        Ok(Self {
            name: Stage::ActorCritic.name(),
            identity: Identity::without_data(config, Stage::ActorCritic)?,
            run: &config.run,
            stage: &config.actor_critic,
            policy: Policy::of_stage(config, Stage::Gpt)?,
            motion: motion_weights(config)?,
            init,
            songs,
        })
    }
}

pub(super) struct ActorCriticStage<'a, A: Trainable> {
    stage: &'a ActorCriticConfig,
    batch: usize,
    base_layers: usize,
    policy: Policy,
    /// The policy as the stage found it.
    reference: Parameters<A::InnerBackend>,
    critic: CriticNet,
    rollout_plan: RolloutPlan,
    rewards: RewardFn,
    steps_of_epoch: u64,
    rollout: Option<Rollout>,
    device: A::Device,
}

/// Whose turn it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    Actor,
    Critic,
    Both,
}

impl ActorCriticConfig {
    /// Returns whose turn a step is.
    fn turn(&self, step: u64) -> Turn {
        let Some(step) = step.checked_sub(self.critic_warmup_steps) else {
            return Turn::Critic;
        };
        let round = self.actor_steps + self.critic_steps;
        match self.critic_steps {
            0 => Turn::Both,
            _ if step % round < self.actor_steps => Turn::Actor,
            _ => Turn::Critic,
        }
    }

    /// Returns the weight of the divergence; none in the first `free_steps`, so that the policy
    /// finds rewarded motion before it is pulled back.
    fn divergence_weight_at(&self, step: u64) -> f64 {
        match step < self.free_steps {
            true => 0.0,
            false => self.divergence_weight,
        }
    }

    /// Returns the rule of the rewards.
    pub(super) fn rule(&self) -> RewardRule {
        RewardRule {
            beat: self.reward,
            beat_weight: self.beat_weight,
            consistency_weight: self.consistency_weight,
            slow_weight: self.slow_weight,
            speed_weight: self.speed_weight,
        }
    }
}

impl<'a, A: Trainable> ActorCriticStage<'a, A> {
    /// The critic starts from `init`, else from where the policy's own critic was left, else from
    /// random weights.
    pub(super) fn new(
        config: &'a Config,
        task: RewardTask<'a>,
        rewards: RewardFn,
        device: &A::Device,
    ) -> Result<(StageSpec<'a>, Self), TrainError> {
        let (settings, policy) = (task.stage, task.policy);
        let mut store = policy.store.clone();
        let reference = Parameters::from_store(&store, device);
        let critic = match (task.init, &policy.critic) {
            (Some(path), _) => official_critic(config, path)?,
            (None, Some(critic)) => critic.clone(),
            (None, None) => first_critic(config),
        };
        let critic = CriticNet::new(&critic, &mut store);
        let rollout_plan = rollout_plan(config, settings, scaled(task.songs, &policy))?;
        let batch = settings.training.batch;
        let steps_of_epoch = rollout_plan.windows().div_ceil(batch);
        let spec = StageSpec {
            name: task.name,
            run: task.run,
            training: &settings.training,
            identity: task.identity,
            store,
            windows: steps_of_epoch * batch,
        };
        let stage = Self {
            stage: settings,
            batch,
            base_layers: config.gpt.base_layers,
            critic,
            rollout_plan,
            rewards,
            policy,
            reference,
            steps_of_epoch: steps_of_epoch as u64,
            rollout: None,
            device: device.clone(),
        };
        Ok((spec, stage))
    }

    /// Returns the epoch's pieces: generated at its first step, kept (also in checkpoints) to its
    /// last.
    fn rollout(&mut self, frozen: &Parameters<A::InnerBackend>, epoch: u64) -> Rollout {
        match self.rollout.take() {
            Some(rollout) if rollout.epoch == epoch => rollout,
            earlier => {
                let sampler = Sampler {
                    net: &self.policy.net,
                    parameters: frozen,
                    temperature: self.stage.temperature,
                };
                let (starts, earlier) = (&self.policy.starts, earlier.as_ref());
                self.rollout_plan.roll_out(
                    epoch,
                    &sampler,
                    starts,
                    earlier,
                    self.batch,
                    &self.rewards,
                )
            }
        }
    }
}

/// Runs a stage that learns from rewards.
pub(super) fn learn_from_rewards<A: Trainable>(
    config: &Config,
    task: RewardTask<'_>,
    device: &A::Device,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    let decoder = MotionDecoder::<A::InnerBackend>::new(config, &task.motion, device);
    let rewards = reward_fn(decoder, task.stage.rule());
    let (spec, mut stage) = ActorCriticStage::<A>::new(config, task, rewards, device)?;
    run(&spec, &mut stage, device, limits, output)
}

impl<A: Trainable> TrainableStage<A> for ActorCriticStage<'_, A> {
    const COLUMNS: &'static [&'static str] = &[
        "loss",
        "actor",
        "critic",
        "entropy",
        "reward",
        "beat_reward",
        "consistency",
        "divergence",
    ];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let frozen = parameters.untracked();
        let (epoch, place) = (step / self.steps_of_epoch, step % self.steps_of_epoch);
        let rollout = self.rollout(&frozen, epoch);
        let windows = rollout.batch(place, self.batch);
        let stage = self.stage;
        let lead = stage.reward_lead;
        let batch =
            TrajectoryBatch::new(&self.rollout_plan, &rollout, &windows, lead, &self.device);
        // The state network is frozen and runs without dropout: it never sees `parameters`.
        let states = self.policy.net.states(
            &frozen,
            batch.music.clone(),
            batch.states.clone(),
            self.base_layers,
            0.0,
        );
        let policy = &self.policy.net;
        let reference = policy.policy(&self.reference, states.clone(), self.base_layers, 0.0);
        let states = Tensor::<A, 3>::from_inner(states);
        let values = self.critic.forward(parameters, states.clone());
        let td_error = batch.td_error(values.clone(), stage.discount);
        let mut advantage =
            batch.generalised_advantage(td_error.clone(), stage.discount * stage.trace).detach();
        // The published loss squares the TD error, with a derivative through both values; a trace
        // needs a fixed target.
        let critic = batch.mean(match stage.trace {
            0.0 => td_error.square(),
            _ => {
                let [_, moves] = advantage.dims();
                let values = values.narrow(1, 0, moves);
                let target = values.clone().detach() + advantage.clone();
                (target - values).square()
            }
        });
        if stage.standardise_advantage {
            advantage = batch.standardised(advantage);
        }
        let logits = policy.policy(parameters, states, self.base_layers, 0.0);
        let divergence = batch.mean(batch.divergence(logits.clone(), reference));
        let (cross_entropy, entropy) = batch.policy(logits);
        let actor = batch.mean(cross_entropy * advantage);
        let entropy = batch.mean(entropy);
        let actor = actor - entropy.clone().mul_scalar(stage.entropy_weight)
            + divergence.clone().mul_scalar(stage.divergence_weight_at(step));
        let [actor_value, critic_value, entropy] =
            [&actor, &critic, &entropy].map(|loss| loss.clone().inner());
        let mut metrics =
            vec![actor_value.clone() + critic_value.clone(), actor_value, critic_value, entropy];
        let means = rollout.mean_rewards;
        metrics.extend(means.map(|mean| Tensor::from_floats([mean], &self.device)));
        metrics.push(divergence.inner());
        self.rollout = Some(rollout);
        // Weights without a derivative rest: those of the critic in a turn of the actor, and back.
        let loss = match stage.turn(step) {
            Turn::Actor => actor,
            Turn::Critic => critic,
            Turn::Both => actor + critic,
        };
        Losses { loss, metrics }
    }

    fn rate_factor(&self, name: &str) -> f64 {
        if name.starts_with("critic") {
            return self.stage.critic_rate_factor;
        }
        // Scales, shifts and biases.
        let gain = name.contains("norm") || name.ends_with("bias");
        match gain || !self.stage.gains_only {
            true => 1.0,
            false => 0.0,
        }
    }

    fn save(&self, checkpoint: &mut Checkpoint) {
        self.policy.save(checkpoint);
        if let Some(rollout) = &self.rollout {
            rollout.save(checkpoint);
        }
    }

    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), String> {
        self.rollout = self.rollout_plan.restore(checkpoint)?;
        Ok(())
    }
}

/// Plans what an epoch generates, for the songs that are long enough for a window.
fn rollout_plan(
    config: &Config,
    stage: &ActorCriticConfig,
    songs: Vec<Song>,
) -> Result<RolloutPlan, TrainError> {
    let mut rollout_plan = RolloutPlan {
        songs,
        pieces: stage.pieces_per_epoch,
        codes: match stage.codes {
            0 => usize::MAX,
            codes => codes,
        },
        takes: stage.takes,
        continued: stage.continued,
        block: config.gpt.block,
        seed: config.run.seed,
    };
    rollout_plan.keep_usable();
    if rollout_plan.songs.is_empty() {
        return Err(TrainError::TooShort { length: config.gpt.block + 1, unit: "rows of music" });
    }
    if rollout_plan.pieces == 0 {
        rollout_plan.pieces = rollout_plan.songs.len();
    }
    Ok(rollout_plan)
}

fn scaled(songs: &[Song], policy: &Policy) -> Vec<Song> {
    let songs = songs.iter().map(|song| Song {
        rows: policy.conditioned(&song.rows, song.style.as_deref()),
        ..song.clone()
    });
    songs.collect()
}

/// Reads the critic of an official checkpoint, which must be of the configured size.
fn official_critic(config: &Config, path: &Path) -> Result<CriticWeights, TrainError> {
    let critic =
        CriticWeights::from_checkpoint(&mut TorchCheckpoint::open(path)?, config.gpt.heads)?;
    let stored = |critic: &CriticWeights| {
        let mut store = Store::default();
        let _plan = CriticNet::new(critic, &mut store);
        store
    };
    if stored(&critic).fits(&stored(&first_critic(config))) {
        return Ok(critic);
    }
    let message = "has a critic of other sizes than [gpt] and [actor_critic] say";
    Err(TrainError::state(path)(message.into()))
}

#[cfg(test)]
mod tests;
