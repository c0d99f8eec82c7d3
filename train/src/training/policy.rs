//! The motion GPT as a finished stage left it: what `actor-critic`, `adapt` and `export` start from.

use ndarray::Array2;

use super::{
    Config, Stage, TrainError,
    config::RunConfig,
    gpt::random,
    keep::{is_finished, read_kept},
    music_scale::MusicScale,
    runner::{WEIGHT, checkpoint_path},
    saved::Saved,
};
use crate::{
    Tensor,
    nn::{CriticNet, GptNet, Store, random_critic},
    weights::{CriticWeights, GptWeights},
};

/// A generator's seed for the critic's first weights.
const CRITIC_SEED: u64 = 0x6372_6974;

/// State network and policy, and what belongs to them.
pub(super) struct Policy {
    pub(super) net: GptNet,
    pub(super) store: Store,
    pub(super) scale: MusicScale,
    /// Pairs of upper and lower codes that training pieces begin with.
    pub(super) starts: Vec<[u32; 2]>,
    /// The critic that learned beside it, where one did.
    pub(super) critic: Option<CriticWeights>,
}

impl Policy {
    /// That of a finished stage, `gpt` or `actor-critic`.
    pub(super) fn of_stage(config: &Config, stage: Stage) -> Result<Self, TrainError> {
        let (path, saved) = read_kept(config, stage)?;
        Self::restore(config, &saved).map_err(|message| TrainError::State { path, message })
    }

    /// `actor-critic` where the run has that stage and it is finished, else `gpt`.
    pub(super) fn latest_stage(config: &Config) -> Result<Stage, TrainError> {
        if config.actor_critic.enabled && is_finished(config, Stage::ActorCritic)? {
            return Ok(Stage::ActorCritic);
        }
        Ok(Stage::Gpt)
    }

    /// That of [`Policy::latest_stage`]; of what rewards changed, as much as `actor_critic.kept` says.
    pub(super) fn latest(config: &Config) -> Result<Self, TrainError> {
        let stage = Self::latest_stage(config)?;
        let latest = Self::of_stage(config, stage)?;
        let kept = config.actor_critic.kept;
        if stage != Stage::ActorCritic || kept == 1.0 {
            return Ok(latest);
        }
        let before = Self::of_stage(config, Stage::Gpt)?;
        Ok(Self {
            store: before.store.towards(&latest.store, kept),
            ..latest
        })
    }

    /// That of a stage in a folder beside the run.
    pub(super) fn of_folder(
        config: &Config,
        run: &RunConfig,
        stage: &'static str,
    ) -> Result<Self, TrainError> {
        let saved = Saved::finished(run, stage)?;
        Self::restore(config, &saved).map_err(|message| TrainError::State {
            path: checkpoint_path(run, stage),
            message,
        })
    }

    fn restore(config: &Config, saved: &Saved) -> Result<Self, String> {
        let scale = MusicScale::restore(saved)?;
        let mut store = Store::default();
        let weights = random(config, scale.mean.len());
        let net = config.ablation.network(&weights, &mut store);
        let pairs = saved.tensor("start_codes")?.data().as_chunks::<2>().0;
        let pairs = pairs.iter().map(|pair| pair.map(|code| code as u32));
        let mut critic_store = Store::default();
        let critic = CriticNet::new(&first_critic(config), &mut critic_store);
        let critic_store = saved.fill(WEIGHT, &critic_store).ok();
        Ok(Self {
            net,
            store: saved.fill(WEIGHT, &store)?,
            scale,
            starts: pairs.collect(),
            critic: critic_store.map(|store| critic.weights(&store)),
        })
    }

    /// Takes what belongs to the weights into a checkpoint that [`Policy::of_stage`] understands.
    pub(super) fn save(&self, saved: &mut Saved) {
        let starts: Vec<f32> = self
            .starts
            .concat()
            .iter()
            .map(|&code| code as f32)
            .collect();
        let tensors = [
            ("music.mean", vec![self.scale.mean.len()], &self.scale.mean),
            (
                "music.spread",
                vec![self.scale.spread.len()],
                &self.scale.spread,
            ),
            ("start_codes", vec![self.starts.len(), 2], &starts),
        ];
        for (name, shape, values) in tensors {
            let tensor = Tensor::from_fn(shape, |place| values[place]);
            saved.tensors.insert(name.into(), tensor);
        }
    }

    /// Music rows as the weights in the store take them.
    pub(super) fn scaled(&self, rows: &Array2<f32>) -> Array2<f32> {
        let mut scaled = Array2::zeros(rows.dim());
        for (mut scaled, row) in scaled.rows_mut().into_iter().zip(rows.rows()) {
            for (scaled, value) in scaled.iter_mut().zip(self.scale.seen(row)) {
                *scaled = value;
            }
        }
        scaled
    }

    /// The weights for plain features: the scale is folded in.
    pub(super) fn weights(&self) -> GptWeights {
        let mut weights = self.net.weights(&self.store);
        weights.music = self.scale.fold(&weights.music);
        weights
    }
}

/// A critic of the configured size that knows nothing.
pub(super) fn first_critic(config: &Config) -> CriticWeights {
    let layers = config.actor_critic.critic_layers;
    let seed = config.run.seed ^ CRITIC_SEED;
    random_critic(config.gpt.channels, config.gpt.heads, layers, seed)
}
