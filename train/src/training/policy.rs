//! The motion GPT of a finished stage, from which `actor-critic`, `adapt` and `export` start.

use bailando::model::Manifest;
use ndarray::Array2;

use super::{
    checkpoint::Checkpoint,
    config::Config,
    error::TrainError,
    gpt::random,
    identity::is_finished,
    kept::{WEIGHT, read_kept},
    manners::Manners,
    music_scale::MusicScale,
    stage::Stage,
};
use crate::{
    nn::{CriticNet, GptNet, Store, random_critic},
    weights::{CriticWeights, GptWeights},
};

/// A generator's seed for the critic's first weights.
const CRITIC_SEED: u64 = 0x6372_6974;

/// State network and policy, with the scale of their music.
pub(super) struct Policy {
    pub(super) net: GptNet,
    pub(super) store: Store,
    pub(super) scale: MusicScale,
    /// What it is told beside the music.
    pub(super) manners: Manners,
    /// Pairs of upper and lower codes that training pieces begin with.
    pub(super) starts: Vec<[u32; 2]>,
    /// The critic that learned beside it, if any.
    pub(super) critic: Option<CriticWeights>,
}

impl Policy {
    /// Reads that of a finished stage, `gpt` or `actor-critic`.
    pub(super) fn of_stage(config: &Config, stage: Stage) -> Result<Self, TrainError> {
        let (path, checkpoint) = read_kept(config, stage)?;
        Self::restore(config, &checkpoint).map_err(TrainError::state(&path))
    }

    /// Returns `actor-critic` where the run has that stage and it is finished, else `gpt`.
    pub(super) fn latest_stage(config: &Config) -> Result<Stage, TrainError> {
        if config.actor_critic.enabled && is_finished(config, Stage::ActorCritic)? {
            return Ok(Stage::ActorCritic);
        }
        Ok(Stage::Gpt)
    }

    /// Reads that of [`Policy::latest_stage`], with the share `actor_critic.kept` of what the
    /// rewards changed.
    pub(super) fn latest(config: &Config) -> Result<Self, TrainError> {
        let stage = Self::latest_stage(config)?;
        let latest = Self::of_stage(config, stage)?;
        let kept = config.actor_critic.kept;
        if stage != Stage::ActorCritic || kept == 1.0 {
            return Ok(latest);
        }
        let before = Self::of_stage(config, Stage::Gpt)?;
        Ok(Self { store: before.store.towards(&latest.store, kept), ..latest })
    }

    /// Takes that of a model directory, whose weights are for plain features.
    pub(super) fn of_model(weights: &GptWeights, manifest: &Manifest) -> Self {
        let mut store = Store::default();
        Self {
            net: GptNet::new(weights, &mut store),
            store,
            scale: MusicScale::plain(weights.columns()),
            manners: Manners { styles: manifest.styles.clone(), energy: manifest.energy },
            starts: manifest.start_codes.clone(),
            critic: None,
        }
    }

    /// The same network with a checkpoint's weights and starts.
    pub(super) fn with_weights(self, checkpoint: &Checkpoint) -> Result<Self, String> {
        let (store, starts) = (checkpoint.fill(WEIGHT, &self.store)?, starts(checkpoint)?);
        Ok(Self { store, starts, ..self })
    }

    /// Takes that of a stage's checkpoint.
    pub(super) fn restore(config: &Config, checkpoint: &Checkpoint) -> Result<Self, String> {
        let scale = MusicScale::restore(checkpoint)?;
        let mut store = Store::default();
        let weights = random(config, scale.mean.len());
        let net = config.ablation.network(&weights, &mut store);
        let mut critic_store = Store::default();
        let critic = CriticNet::new(&first_critic(config), &mut critic_store);
        let critic_store = checkpoint.fill(WEIGHT, &critic_store).ok();
        Ok(Self {
            net,
            store: checkpoint.fill(WEIGHT, &store)?,
            scale,
            manners: Manners::restore(checkpoint)?,
            starts: starts(checkpoint)?,
            critic: critic_store.map(|store| critic.weights(&store)),
        })
    }

    /// Adds scale and starts to a checkpoint that [`Policy::of_stage`] reads.
    pub(super) fn save(&self, checkpoint: &mut Checkpoint) {
        self.scale.save(checkpoint);
        self.manners.save(checkpoint);
        let starts = self.starts.as_flattened().iter();
        let starts: Vec<f32> = starts.map(|&code| code as f32).collect();
        checkpoint.put_rows("start_codes", 2, &starts);
    }

    /// Scales the rows of a song for the weights in the store, its style beside them.
    pub(super) fn conditioned(&self, rows: &Array2<f32>, style: Option<&str>) -> Array2<f32> {
        let manner = self.manners.of_style(style);
        self.scaled(&self.manners.spec().beside(rows.view(), manner))
    }

    /// Scales rows with all columns.
    pub(super) fn scaled(&self, rows: &Array2<f32>) -> Array2<f32> {
        let mut scaled = Array2::zeros(rows.dim());
        for (mut scaled, row) in scaled.rows_mut().into_iter().zip(rows.rows()) {
            for (scaled, value) in scaled.iter_mut().zip(self.scale.scaled(row)) {
                *scaled = value;
            }
        }
        scaled
    }

    /// Returns the weights for plain features: the scale is folded in.
    pub(super) fn weights(&self) -> GptWeights {
        let mut weights = self.net.weights(&self.store);
        weights.music = self.scale.fold(&weights.music);
        weights
    }
}

/// Reads the pairs of codes that pieces begin with.
fn starts(checkpoint: &Checkpoint) -> Result<Vec<[u32; 2]>, String> {
    let pairs = checkpoint.tensor("start_codes")?.data().as_chunks::<2>().0;
    Ok(pairs.iter().map(|pair| pair.map(|code| code as u32)).collect())
}

/// Returns an untrained critic of the configured size.
pub(super) fn first_critic(config: &Config) -> CriticWeights {
    let layers = config.actor_critic.critic_layers;
    let seed = config.run.seed ^ CRITIC_SEED;
    random_critic(config.gpt.channels, config.gpt.heads, layers, seed)
}
