//! Stage `actor-critic` (paper section 3.3, Eq. 7-11; ARCHITECTURE section 6): the policy learns
//! from rewards of what it generates itself, beside a critic that tells what was to be expected.

use std::path::Path;

use burn_tensor::{
    Int, Tensor as Device, TensorData, activation::log_softmax, backend::AutodiffBackend,
};

use super::{
    Config, TrainError,
    config::{ActorCriticConfig, RunConfig},
    decode::DanceDecoder,
    policy::{Policy, first_critic},
    reward::RewardRule,
    rollout::{Judge, Repertoire, Rollout},
    runner::{Losses, Plan, Work},
    sampling::{Sampler, Window, inputs},
    saved::Saved,
    songs::Song,
};
use crate::{
    checkpoint::Checkpoint,
    nn::{CriticNet, Logits, Parameters, Store},
    weights::CriticWeights,
};

/// A stage that learns this way.
pub(super) struct Task<'a> {
    pub(super) name: &'static str,
    pub(super) run: &'a RunConfig,
    pub(super) stage: &'a ActorCriticConfig,
}

pub(super) struct ActorCriticWork<'a, A: AutodiffBackend> {
    stage: &'a ActorCriticConfig,
    batch: usize,
    base_layers: usize,
    policy: Policy,
    critic: CriticNet,
    repertoire: Repertoire,
    judge: Judge<A::InnerBackend>,
    steps_of_epoch: u64,
    rollout: Option<Rollout>,
    device: A::Device,
}

/// Whose turn it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    Actor,
    Critic,
}

impl ActorCriticConfig {
    /// Whose turn a step is, and how many steps before it were of the same kind.
    fn turn(&self, step: u64) -> (Turn, u64) {
        let Some(step) = step.checked_sub(self.critic_warmup_steps) else {
            return (Turn::Critic, step);
        };
        let round = self.actor_steps + self.critic_steps;
        let (rounds, place) = (step / round, step % round);
        if place < self.actor_steps {
            return (Turn::Actor, rounds * self.actor_steps + place);
        }
        let earlier = rounds * self.critic_steps + place - self.actor_steps;
        (Turn::Critic, self.critic_warmup_steps + earlier)
    }

    /// What the result depends on.
    fn settings(&self) -> String {
        let settings = Self {
            enabled: true,
            ..self.clone()
        };
        format!("{settings:?}")
    }

    fn rule(&self) -> RewardRule {
        RewardRule {
            beat: self.reward,
            beat_weight: self.beat_weight,
            consistency_weight: self.consistency_weight,
        }
    }
}

impl<'a, A: AutodiffBackend> ActorCriticWork<'a, A> {
    /// Starts from a policy; the critic from `init` (an official checkpoint), else from where the
    /// policy's own critic was left, else from random weights.
    pub(super) fn new(
        config: &'a Config,
        task: Task<'a>,
        policy: Policy,
        songs: &[Song],
        init: Option<&Path>,
        device: &A::Device,
    ) -> Result<(Plan<'a>, Self), TrainError> {
        let stage = task.stage;
        let mut store = policy.store.clone();
        let critic = match (init, &policy.critic) {
            (Some(path), _) => official_critic(config, path)?,
            (None, Some(critic)) => critic.clone(),
            (None, None) => first_critic(config),
        };
        let critic = CriticNet::new(&critic, &mut store);
        let mut repertoire = Repertoire {
            songs: scaled(songs, &policy),
            pieces: stage.pieces_per_epoch,
            codes: match stage.codes {
                0 => usize::MAX,
                codes => codes,
            },
            block: config.gpt.block,
            seed: config.run.seed,
        };
        repertoire.keep_usable();
        if repertoire.songs.is_empty() {
            return Err(TrainError::TooShort {
                length: config.gpt.block + 1,
                unit: "rows of music",
            });
        }
        if repertoire.pieces == 0 {
            repertoire.pieces = repertoire.songs.len();
        }
        let batch = stage.training.batch;
        let steps_of_epoch = repertoire.windows().div_ceil(batch);
        let plan = Plan {
            name: task.name,
            run: task.run,
            training: &stage.training,
            settings: format!("seed {} {}", config.run.seed, stage.settings()),
            store,
            windows: steps_of_epoch * batch,
        };
        let work = Self {
            stage,
            batch,
            base_layers: config.gpt.base_layers,
            critic,
            repertoire,
            judge: Judge {
                decoder: DanceDecoder::read(config, device)?,
                rule: stage.rule(),
            },
            policy,
            steps_of_epoch: steps_of_epoch as u64,
            rollout: None,
            device: device.clone(),
        };
        Ok((plan, work))
    }

    /// The epoch's pieces: generated at its first step, kept (also in checkpoints) to its last.
    fn rollout(&mut self, frozen: &Parameters<A::InnerBackend>, epoch: u64) -> Rollout {
        match self.rollout.take() {
            Some(rollout) if rollout.epoch == epoch => rollout,
            _ => {
                let sampler = Sampler {
                    net: &self.policy.net,
                    parameters: frozen,
                    temperature: self.stage.temperature,
                };
                let starts = &self.policy.starts;
                self.repertoire
                    .roll_out(epoch, &sampler, starts, self.batch, &self.judge)
            }
        }
    }

    /// The windows' parts of the pieces.
    fn lesson(&self, rollout: &Rollout, windows: &[(usize, usize)]) -> Lesson<A> {
        let (block, moves) = (self.repertoire.block, self.repertoire.block - 1);
        let excerpts: Vec<Window<'_>> = windows
            .iter()
            .map(|&(piece, first)| Window {
                music: self.repertoire.music(rollout.episodes[piece].excerpt),
                codes: &rollout.episodes[piece].codes,
                first,
            })
            .collect();
        let (music, states) = inputs(&excerpts, block, &self.device);
        let shape = [windows.len(), moves];
        let taken = [0, 1].map(|half| {
            let codes = excerpts
                .iter()
                .flat_map(|window| &window.codes[half][window.first + 1..][..moves]);
            let codes: Vec<i32> = codes.copied().collect();
            Device::from_data(TensorData::new(codes, shape), &self.device)
        });
        let rewards = windows.iter().flat_map(|&(piece, first)| {
            let rewards = &rollout.episodes[piece].rewards[first + 1..][..moves];
            rewards.iter().map(|[total, ..]| *total)
        });
        let rewards: Vec<f32> = rewards.collect();
        // Windows overlap: all steps of a piece's first count, of the others the last alone.
        let counts = windows.iter().flat_map(|&(_, first)| {
            (0..moves).map(move |step| f32::from(u8::from(first == 0 || step + 1 == moves)))
        });
        let counts: Vec<f32> = counts.collect();
        let total: f32 = counts.iter().sum();
        let shares = counts
            .iter()
            .map(|count| count / total)
            .collect::<Vec<f32>>();
        Lesson {
            music,
            states,
            taken,
            rewards: Device::from_data(TensorData::new(rewards, shape), &self.device),
            shares: Device::from_data(TensorData::new(shares, shape), &self.device),
        }
    }
}

/// A batch of windows of `block` codes: as many states, and one move fewer between them. (The 30th
/// code of ARCHITECTURE section 6 is only the target of a move that no reward is known for.)
struct Lesson<A: AutodiffBackend> {
    music: Device<A::InnerBackend, 3>,
    /// The codes so far in each state, `[windows, block]`.
    states: [Device<A::InnerBackend, 2, Int>; 2],
    /// The codes that were drawn in each state but the last, `[windows, block - 1]`.
    taken: [Device<A, 2, Int>; 2],
    /// Of those codes.
    rewards: Device<A, 2>,
    /// What each move counts in means over the batch; together 1.
    shares: Device<A, 2>,
}

impl<A: AutodiffBackend> Lesson<A> {
    /// Cross-entropy of the codes taken, and entropy of the policy; upper + lower of each move.
    fn policy(&self, logits: Logits<A>) -> (Device<A, 2>, Device<A, 2>) {
        let [windows, moves] = self.rewards.dims();
        let half = |logits: Device<A, 3>, taken: &Device<A, 2, Int>| {
            let scores = log_softmax(logits.narrow(1, 0, moves), 2);
            let surprise = scores
                .clone()
                .gather(2, taken.clone().unsqueeze_dim::<3>(2));
            let entropy = (scores.clone().exp() * scores).sum_dim(2);
            [surprise, entropy].map(|sum| sum.neg().reshape([windows, moves]))
        };
        let [upper, upper_entropy] = half(logits.upper, &self.taken[0]);
        let [lower, lower_entropy] = half(logits.lower, &self.taken[1]);
        (upper + lower, upper_entropy + lower_entropy)
    }

    /// `TD = r + discount * v[1:] - v[:-1]` (Eq. 9).
    fn surprise(&self, values: Device<A, 2>, discount: f64) -> Device<A, 2> {
        let [_, moves] = self.rewards.dims();
        let next = values.clone().narrow(1, 1, moves);
        self.rewards.clone() + next.mul_scalar(discount) - values.narrow(1, 0, moves)
    }

    fn mean(&self, values: Device<A, 2>) -> Device<A, 1> {
        (values * self.shares.clone()).sum()
    }
}

impl<A: AutodiffBackend> Work<A> for ActorCriticWork<'_, A> {
    const COLUMNS: &'static [&'static str] = &[
        "loss",
        "actor",
        "critic",
        "entropy",
        "reward",
        "beat_reward",
        "consistency",
    ];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let frozen = parameters.untracked();
        let (epoch, place) = (step / self.steps_of_epoch, step % self.steps_of_epoch);
        let rollout = self.rollout(&frozen, epoch);
        let lesson = self.lesson(&rollout, &rollout.batch(place, self.batch));
        // The state network is frozen and runs without dropout: it never sees `parameters`.
        let states = self.policy.net.states(
            &frozen,
            lesson.music.clone(),
            lesson.states.clone(),
            self.base_layers,
            0.0,
        );
        let states = Device::<A, 3>::from_inner(states);
        let values = self.critic.forward(parameters, states.clone());
        let surprise = lesson.surprise(values, self.stage.discount);
        let critic = lesson.mean(surprise.clone().square());
        let logits = self
            .policy
            .net
            .policy(parameters, states, self.base_layers, 0.0);
        let (cross_entropy, entropy) = lesson.policy(logits);
        let actor = lesson.mean(cross_entropy * surprise.detach());
        let entropy = lesson.mean(entropy);
        let actor = actor - entropy.clone().mul_scalar(self.stage.entropy_weight);
        let [actor_value, critic_value, entropy] =
            [&actor, &critic, &entropy].map(|loss| loss.clone().inner());
        let mut metrics = vec![
            actor_value.clone() + critic_value.clone(),
            actor_value,
            critic_value,
            entropy,
        ];
        let means = rollout.mean_rewards();
        metrics.extend(means.map(|mean| Device::from_floats([mean], &self.device)));
        self.rollout = Some(rollout);
        // What has no derivative does not move: in a turn of the one the other rests.
        let loss = match self.stage.turn(step) {
            (Turn::Actor, _) => actor,
            (Turn::Critic, _) => critic,
        };
        Losses { loss, metrics }
    }

    fn earlier_updates(&self, step: u64) -> u64 {
        let (_, earlier) = self.stage.turn(step);
        earlier
    }

    fn save(&self, saved: &mut Saved) {
        self.policy.save(saved);
        if let Some(rollout) = &self.rollout {
            rollout.save(saved);
        }
    }

    fn restore(&mut self, saved: &Saved) -> Result<(), String> {
        self.rollout = self.repertoire.restore(saved)?;
        Ok(())
    }
}

fn scaled(songs: &[Song], policy: &Policy) -> Vec<Song> {
    let songs = songs.iter().map(|song| Song {
        rows: policy.scaled(&song.rows),
        beats: song.beats.clone(),
    });
    songs.collect()
}

/// The critic of an official checkpoint, which must be of the configured size.
fn official_critic(config: &Config, path: &Path) -> Result<CriticWeights, TrainError> {
    let critic = CriticWeights::from_checkpoint(&mut Checkpoint::open(path)?, config.gpt.heads)?;
    let shapes = |critic: &CriticWeights| -> Vec<(String, Vec<usize>)> {
        let mut store = Store::default();
        let _plan = CriticNet::new(critic, &mut store);
        let entries = store.entries().iter();
        entries
            .map(|(name, tensor)| (name.clone(), tensor.shape().to_vec()))
            .collect()
    };
    if shapes(&critic) == shapes(&first_critic(config)) {
        return Ok(critic);
    }
    Err(TrainError::State {
        path: path.to_owned(),
        message: "has a critic of other sizes than [gpt] and [actor_critic] say".into(),
    })
}
