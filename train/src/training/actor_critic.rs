//! Stage `actor-critic` (paper section 3.3, Eq. 7-11; ARCHITECTURE section 6): the policy learns
//! from rewards of what it generates itself, beside a critic that tells what was to be expected.

use std::path::Path;

use burn_tensor::Tensor as Device;

use super::{
    Config, Stage, TrainError,
    config::{ActorCriticConfig, RunConfig},
    keep::settings,
    lesson::Lesson,
    policy::{Policy, first_critic},
    reward::RewardRule,
    rollout::{Judge, Repertoire, Rollout},
    runner::{Losses, Plan, Work},
    sampling::Sampler,
    saved::Saved,
    song::Song,
};
use crate::{
    checkpoint::Checkpoint,
    nn::{CriticNet, Parameters, Store, Trainable},
    weights::CriticWeights,
};

/// A stage that learns this way.
pub(super) struct Task<'a> {
    pub(super) name: &'static str,
    /// All that its result depends on.
    pub(super) settings: String,
    pub(super) run: &'a RunConfig,
    pub(super) stage: &'a ActorCriticConfig,
    /// What it starts from.
    pub(super) policy: Policy,
    /// An official checkpoint whose critic is the first.
    pub(super) init: Option<&'a Path>,
    /// What is danced to.
    pub(super) songs: &'a [Song],
}

impl<'a> Task<'a> {
    /// That of a run: the policy of its finished `gpt` on the songs of the training split.
    pub(super) fn of_run(
        config: &'a Config,
        songs: &'a [Song],
        init: Option<&'a Path>,
    ) -> Result<Self, TrainError> {
        Ok(Self {
            name: Stage::ActorCritic.name(),
            settings: settings(config, Stage::ActorCritic)?,
            run: &config.run,
            stage: &config.actor_critic,
            policy: Policy::of_stage(config, Stage::Gpt)?,
            init,
            songs,
        })
    }
}

pub(super) struct ActorCriticWork<'a, A: Trainable> {
    stage: &'a ActorCriticConfig,
    batch: usize,
    base_layers: usize,
    policy: Policy,
    /// The policy as the stage found it.
    reference: Parameters<A::InnerBackend>,
    critic: CriticNet,
    repertoire: Repertoire,
    judge: Judge,
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
    /// Whose turn a step is, and how many steps before it were of the same kind.
    fn turn(&self, step: u64) -> (Turn, u64) {
        let Some(step) = step.checked_sub(self.critic_warmup_steps) else {
            return (Turn::Critic, step);
        };
        if self.critic_steps == 0 {
            return (Turn::Both, step);
        }
        let round = self.actor_steps + self.critic_steps;
        let (rounds, place) = (step / round, step % round);
        if place < self.actor_steps {
            return (Turn::Actor, rounds * self.actor_steps + place);
        }
        let earlier = rounds * self.critic_steps + place - self.actor_steps;
        (Turn::Critic, self.critic_warmup_steps + earlier)
    }

    /// Of the first `free_steps` none: what pays is found before the policy is called back.
    fn divergence_weight_at(&self, step: u64) -> f64 {
        match step < self.free_steps {
            true => 0.0,
            false => self.divergence_weight,
        }
    }

    /// What the result depends on: how much of it is kept is asked afterwards.
    pub(super) fn settings(&self) -> String {
        let settings = Self {
            enabled: true,
            kept: 1.0,
            ..self.clone()
        };
        format!("{settings:?}")
    }

    /// What rewards are.
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

impl<'a, A: Trainable> ActorCriticWork<'a, A> {
    /// The critic starts from `init`, else from where the policy's own critic was left, else from
    /// random weights.
    pub(super) fn new(
        config: &'a Config,
        task: Task<'a>,
        judge: Judge,
        device: &A::Device,
    ) -> Result<(Plan<'a>, Self), TrainError> {
        let (stage, policy) = (task.stage, task.policy);
        let mut store = policy.store.clone();
        let reference = Parameters::from_store(&store, device);
        let critic = match (task.init, &policy.critic) {
            (Some(path), _) => official_critic(config, path)?,
            (None, Some(critic)) => critic.clone(),
            (None, None) => first_critic(config),
        };
        let critic = CriticNet::new(&critic, &mut store);
        let repertoire = repertoire(config, stage, scaled(task.songs, &policy))?;
        let batch = stage.training.batch;
        let steps_of_epoch = repertoire.windows().div_ceil(batch);
        let plan = Plan {
            name: task.name,
            run: task.run,
            training: &stage.training,
            settings: task.settings,
            store,
            windows: steps_of_epoch * batch,
        };
        let work = Self {
            stage,
            batch,
            base_layers: config.gpt.base_layers,
            critic,
            repertoire,
            judge,
            policy,
            reference,
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
            earlier => {
                let sampler = Sampler {
                    net: &self.policy.net,
                    parameters: frozen,
                    temperature: self.stage.temperature,
                };
                let (starts, earlier) = (&self.policy.starts, earlier.as_ref());
                self.repertoire
                    .roll_out(epoch, &sampler, starts, earlier, self.batch, &self.judge)
            }
        }
    }
}

impl<A: Trainable> Work<A> for ActorCriticWork<'_, A> {
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
        let lesson = Lesson::new(&self.repertoire, &rollout, &windows, lead, &self.device);
        // The state network is frozen and runs without dropout: it never sees `parameters`.
        let states = self.policy.net.states(
            &frozen,
            lesson.music.clone(),
            lesson.states.clone(),
            self.base_layers,
            0.0,
        );
        let policy = &self.policy.net;
        let reference = policy.policy(&self.reference, states.clone(), self.base_layers, 0.0);
        let states = Device::<A, 3>::from_inner(states);
        let values = self.critic.forward(parameters, states.clone());
        let surprise = lesson.surprise(values.clone(), stage.discount);
        let mut advantage = lesson
            .traced(surprise.clone(), stage.discount * stage.trace)
            .detach();
        // The published loss is the surprise's, through both values; a trace needs a fixed target.
        let critic = lesson.mean(match stage.trace {
            0.0 => surprise.square(),
            _ => {
                let [_, moves] = advantage.dims();
                let values = values.narrow(1, 0, moves);
                let target = values.clone().detach() + advantage.clone();
                (target - values).square()
            }
        });
        if stage.standardise_advantage {
            advantage = lesson.standardised(advantage);
        }
        let logits = policy.policy(parameters, states, self.base_layers, 0.0);
        let divergence = lesson.mean(lesson.divergence(logits.clone(), reference));
        let (cross_entropy, entropy) = lesson.policy(logits);
        let actor = lesson.mean(cross_entropy * advantage);
        let entropy = lesson.mean(entropy);
        let actor = actor - entropy.clone().mul_scalar(stage.entropy_weight)
            + divergence
                .clone()
                .mul_scalar(stage.divergence_weight_at(step));
        let [actor_value, critic_value, entropy] =
            [&actor, &critic, &entropy].map(|loss| loss.clone().inner());
        let mut metrics = vec![
            actor_value.clone() + critic_value.clone(),
            actor_value,
            critic_value,
            entropy,
        ];
        let means = rollout.mean_rewards;
        metrics.extend(means.map(|mean| Device::from_floats([mean], &self.device)));
        metrics.push(divergence.inner());
        self.rollout = Some(rollout);
        // What has no derivative does not move: in a turn of the one the other rests.
        let loss = match stage.turn(step) {
            (Turn::Actor, _) => actor,
            (Turn::Critic, _) => critic,
            (Turn::Both, _) => actor + critic,
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

/// The songs that are long enough for a window, and what an epoch takes of them.
fn repertoire(
    config: &Config,
    stage: &ActorCriticConfig,
    songs: Vec<Song>,
) -> Result<Repertoire, TrainError> {
    let mut repertoire = Repertoire {
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
    Ok(repertoire)
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
    let stored = |critic: &CriticWeights| {
        let mut store = Store::default();
        let _plan = CriticNet::new(critic, &mut store);
        store
    };
    if stored(&critic).fits(&stored(&first_critic(config))) {
        return Ok(critic);
    }
    Err(TrainError::State {
        path: path.to_owned(),
        message: "has a critic of other sizes than [gpt] and [actor_critic] say".into(),
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use burn_autodiff::Autodiff;
    use burn_flex::{Flex, FlexDevice};
    use ndarray::Array2;

    use super::*;
    use crate::{
        nn::GptNet,
        training::{Limits, gpt::random, music_scale::MusicScale, runner::run},
    };

    const COLUMNS: usize = 3;

    #[test]
    fn turns_follow_each_other() {
        let mut stage = Config::parse("").unwrap().actor_critic;
        (
            stage.critic_warmup_steps,
            stage.actor_steps,
            stage.critic_steps,
        ) = (1, 2, 3);
        let (mut actor, mut critic) = (0, 0);
        for (step, wanted) in "CAACCCAACCCAA".chars().enumerate() {
            let (wanted, count) = match wanted {
                'A' => (Turn::Actor, &mut actor),
                _ => (Turn::Critic, &mut critic),
            };
            assert_eq!(stage.turn(step as u64), (wanted, *count), "{step}");
            *count += 1;
        }
        stage.critic_steps = 0;
        assert_eq!(stage.turn(0), (Turn::Critic, 0));
        assert_eq!(stage.turn(3), (Turn::Both, 2));
    }

    /// A policy that knows nothing, with small windows.
    fn toy(folder: &Path) -> (Config, Policy, Vec<Song>) {
        let mut config = Config::parse(include_str!("../../presets/tiny.toml")).unwrap();
        config.run.folder = folder.to_owned();
        config.run.log_steps = 1;
        config.gpt.block = 8;
        let stage = &mut config.actor_critic;
        (stage.pieces_per_epoch, stage.codes) = (8, 16);
        (
            stage.training.batch,
            stage.training.epochs,
            stage.training.rate,
        ) = (24, 20, 3e-3);
        let mut store = Store::default();
        let policy = Policy {
            net: GptNet::new(&random(&config, COLUMNS), &mut store),
            store,
            scale: MusicScale {
                mean: vec![0.0; COLUMNS],
                spread: vec![1.0; COLUMNS],
            },
            starts: vec![[3, 5], [9, 1]],
            critic: None,
        };
        let song = |phase: f32| Song {
            rows: Array2::from_shape_fn((30, COLUMNS), |(row, column)| {
                (row as f32 * (0.5 + column as f32) + phase).sin()
            }),
            beats: Vec::new(),
        };
        (config, policy, [0.0, 1.0].map(song).into())
    }

    /// Mean rewards of the first and the last epoch.
    fn learned(judge: Judge) -> [f32; 2] {
        let folder = tempfile::tempdir().unwrap();
        let (config, policy, songs) = toy(folder.path());
        let task = Task {
            name: "actor-critic",
            settings: "toy".into(),
            run: &config.run,
            stage: &config.actor_critic,
            policy,
            init: None,
            songs: &songs,
        };
        let work = ActorCriticWork::<Autodiff<Flex>>::new(&config, task, judge, &FlexDevice);
        let (plan, mut work) = work.unwrap();
        run::<Autodiff<Flex>, _>(
            &plan,
            &mut work,
            &FlexDevice,
            Limits::default(),
            &mut Vec::new(),
        )
        .unwrap();
        let path = folder.path().join("actor-critic/metrics.csv");
        let text = std::fs::read_to_string(path).unwrap();
        let rewards = text
            .lines()
            .skip(1)
            .map(|line| line.split(',').nth(6).unwrap());
        let rewards: Vec<f32> = rewards.map(|reward| reward.parse().unwrap()).collect();
        [rewards[0], rewards[rewards.len() - 1]]
    }

    #[test]
    fn an_official_critic_must_be_of_the_configured_size() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/model");
        let path = Path::new(folder).join("tiny_gpt.pt");
        let mut config = Config::parse("").unwrap();
        (config.gpt.channels, config.gpt.heads) = (48, 4);
        config.actor_critic.critic_layers = 1;
        let critic = official_critic(&config, &path).unwrap();
        assert_ne!(critic, first_critic(&config));
        config.actor_critic.critic_layers = 2;
        let refused = official_critic(&config, &path).unwrap_err();
        assert!(matches!(refused, TrainError::State { .. }), "{refused}");
    }

    #[test]
    fn the_policy_gets_better_at_what_is_rewarded() {
        let quarter = |code: i32| if code % 4 == 0 { 1.0 } else { -1.0 };
        let upper: Judge = Box::new(move |pieces, _| {
            let rewards =
                |[upper, _]: &[Vec<i32>; 2]| upper.iter().map(|&code| [quarter(code); 3]).collect();
            pieces.iter().map(rewards).collect()
        });
        let [first, last] = learned(upper);
        assert!(first < 0.0 && last > first + 0.5, "{first} {last}");
    }
}
