//! The motion GPT of a finished stage, from which `actor-critic`, `adapt` and `export` start.

use std::collections::BTreeMap;

use bailando::model::{Manifest, StyleCodes};
use ndarray::Array2;

use super::{
    checkpoint::Checkpoint,
    config::Config,
    error::TrainError,
    identity::is_finished,
    kept::{WEIGHT, read_kept},
    manners::Manners,
    music_scale::MusicScale,
    stage::Stage,
};
use crate::{
    nn::{CriticNet, GptNet, GptSizes, Store, random_critic, random_gpt},
    weights::{CriticWeights, GptWeights},
};

/// A generator's seed for the critic's first weights.
const CRITIC_SEED: u64 = 0x6372_6974;
/// Names in checkpoints.
const STYLE_STARTS: &str = "style_start_codes";
const STYLE_CODES: &str = "style_codes";

/// Returns a random network of the configured size.
pub(super) fn random(config: &Config, columns: usize) -> GptWeights {
    let gpt = &config.gpt;
    let codes = match config.ablation.continuous {
        true => config.vqvae.embedding,
        false => config.vqvae.codes,
    };
    let sizes = GptSizes {
        channels: gpt.channels,
        heads: gpt.heads,
        layers: gpt.base_layers + gpt.head_layers,
        block: gpt.block,
        codes: [codes, codes],
        columns,
    };
    random_gpt(sizes, config.run.seed ^ 2)
}

/// State network and policy, with the scale of their music.
pub(super) struct Policy {
    pub(super) net: GptNet,
    pub(super) store: Store,
    pub(super) scale: MusicScale,
    /// What it is told beside the music.
    pub(super) manners: Manners,
    /// Pairs of upper and lower codes that training pieces begin with.
    pub(super) starts: Vec<[u32; 2]>,
    /// Those of pieces of each style.
    pub(super) style_starts: BTreeMap<String, Vec<[u32; 2]>>,
    /// Codes of pieces of each style.
    pub(super) style_codes: BTreeMap<String, StyleCodes>,
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
            style_starts: manifest.style_start_codes.clone(),
            style_codes: manifest.style_codes.clone(),
            critic: None,
        }
    }

    /// The same network with a checkpoint's weights and starts.
    pub(super) fn with_weights(self, checkpoint: &Checkpoint) -> Result<Self, String> {
        let style_starts = style_starts(checkpoint, &self.manners.styles)?;
        let (store, starts) = (checkpoint.fill(WEIGHT, &self.store)?, starts(checkpoint)?);
        Ok(Self { store, starts, style_starts, ..self })
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
        let manners = Manners::restore(checkpoint)?;
        Ok(Self {
            net,
            store: checkpoint.fill(WEIGHT, &store)?,
            scale,
            starts: starts(checkpoint)?,
            style_starts: style_starts(checkpoint, &manners.styles)?,
            style_codes: style_codes(checkpoint, &manners.styles)?,
            manners,
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
        put_style_starts(checkpoint, &self.manners.styles, &self.style_starts);
        put_style_codes(checkpoint, &self.manners.styles, &self.style_codes);
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

/// Adds pairs of each style to a checkpoint, rows of style and pair; nothing where there are none.
fn put_style_pairs(
    checkpoint: &mut Checkpoint,
    name: &str,
    styles: &[String],
    pairs: impl Fn(&String) -> Vec<[u32; 2]>,
) {
    let rows = styles.iter().enumerate().flat_map(|(number, style)| {
        pairs(style).into_iter().map(move |[first, second]| [number as u32, first, second])
    });
    let values: Vec<f32> = rows.flatten().map(|value| value as f32).collect();
    if !values.is_empty() {
        checkpoint.put_rows(name, 3, &values);
    }
}

/// Reads pairs of each style; none from a checkpoint of before they were kept.
fn style_pairs(
    checkpoint: &Checkpoint,
    name: &str,
    styles: &[String],
) -> Result<BTreeMap<String, Vec<[u32; 2]>>, String> {
    let mut found: BTreeMap<_, Vec<_>> = BTreeMap::new();
    let Ok(rows) = checkpoint.tensor(name) else {
        return Ok(found);
    };
    for &[style, first, second] in rows.data().as_chunks::<3>().0 {
        let own = styles.get(style as usize);
        let own = own.ok_or_else(|| format!("`{name}`: there is no style {style}"))?;
        found.entry(own.clone()).or_default().push([first, second].map(|value| value as u32));
    }
    Ok(found)
}

/// Adds the pairs of upper and lower codes that each style begins with to a checkpoint.
pub(super) fn put_style_starts(
    checkpoint: &mut Checkpoint,
    styles: &[String],
    starts: &BTreeMap<String, Vec<[u32; 2]>>,
) {
    let of = |style: &String| starts.get(style).cloned().unwrap_or_default();
    put_style_pairs(checkpoint, STYLE_STARTS, styles, of);
}

fn style_starts(
    checkpoint: &Checkpoint,
    styles: &[String],
) -> Result<BTreeMap<String, Vec<[u32; 2]>>, String> {
    style_pairs(checkpoint, STYLE_STARTS, styles)
}

/// Adds the codes of each style to a checkpoint, pairs of half and code.
pub(super) fn put_style_codes(
    checkpoint: &mut Checkpoint,
    styles: &[String],
    codes: &BTreeMap<String, StyleCodes>,
) {
    let of = |style: &String| {
        let halves = codes.get(style).map(|StyleCodes { upper, lower }| [(0, upper), (1, lower)]);
        let halves = halves.into_iter().flatten();
        halves.flat_map(|(half, codes)| codes.iter().map(move |&code| [half, code])).collect()
    };
    put_style_pairs(checkpoint, STYLE_CODES, styles, of);
}

fn style_codes(
    checkpoint: &Checkpoint,
    styles: &[String],
) -> Result<BTreeMap<String, StyleCodes>, String> {
    let pairs = style_pairs(checkpoint, STYLE_CODES, styles)?;
    let own = pairs.into_iter().map(|(style, pairs)| {
        let mut codes = StyleCodes::default();
        for [half, code] in pairs {
            if half == 0 { &mut codes.upper } else { &mut codes.lower }.push(code);
        }
        (style, codes)
    });
    Ok(own.collect())
}

/// Returns an untrained critic of the configured size.
pub(super) fn first_critic(config: &Config) -> CriticWeights {
    let layers = config.actor_critic.critic_layers;
    let seed = config.run.seed ^ CRITIC_SEED;
    random_critic(config.gpt.channels, config.gpt.heads, layers, seed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_styles_have_comes_back_from_a_checkpoint() {
        let styles = ["house", "krump", "lock"].map(str::to_owned);
        let starts: BTreeMap<String, Vec<[u32; 2]>> =
            [("krump".to_owned(), vec![[3, 500]]), ("lock".to_owned(), vec![[1, 2], [0, 7]])]
                .into();
        let mut checkpoint = Checkpoint::default();
        assert_eq!(style_starts(&checkpoint, &styles), Ok(BTreeMap::new()));
        put_style_starts(&mut checkpoint, &styles, &starts);
        assert_eq!(style_starts(&checkpoint, &styles), Ok(starts));
        let refused = style_starts(&checkpoint, &styles[..2]).unwrap_err();
        assert!(refused.ends_with("there is no style 2"), "{refused}");

        let own = StyleCodes { upper: vec![3, 4], lower: vec![500] };
        let codes: BTreeMap<_, _> = [("lock".to_owned(), own)].into();
        assert_eq!(style_codes(&checkpoint, &styles), Ok(BTreeMap::new()));
        put_style_codes(&mut checkpoint, &styles, &codes);
        assert_eq!(style_codes(&checkpoint, &styles), Ok(codes));
        let refused = style_codes(&checkpoint, &styles[..2]).unwrap_err();
        assert!(refused.ends_with("there is no style 2"), "{refused}");
    }
}
