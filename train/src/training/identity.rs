//! What the weights of a stage depend on, and how two of these differ.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::{
    checkpoint::Facts,
    config::Config,
    error::TrainError,
    input::{MotionSet, Motions},
    kept::{checkpoint_path, facts_of, fingerprint},
    stage::Stage,
};
use crate::{data::Training, sha256};

/// Facts in a checkpoint.
const IDENTITY: &str = "identity";
const SETTINGS: &str = "settings";
/// Prefix of the names that describe data.
const DATA: &str = "training data: ";

/// Settings that every stage depends on.
const SHARED: [&str; 5] = ["run.seed", "data.frame", "data.mirror", "data.phases", "data.profile"];

/// Everything that the weights of a stage depend on: values by the name of the setting.
///
/// Settings at their published value are left out. So a setting that a later version adds, with a
/// default that changes nothing, leaves the identity of older checkpoints as it was. The length of
/// the stage is left out as well: a finished stage can be lengthened.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Identity(BTreeMap<String, Value>);

impl Identity {
    /// Returns the identity of a stage of a run, with the amount of data that it learns from.
    pub(super) fn of_stage(
        config: &Config,
        stage: Stage,
        set: &MotionSet,
    ) -> Result<Self, TrainError> {
        Ok(Self::without_data(config, stage)?.with_amount(&set.training))
    }

    /// Returns the identity of a stage of a run as far as no data are read: its settings, and the
    /// weights that it builds on.
    pub(super) fn without_data(config: &Config, stage: Stage) -> Result<Self, TrainError> {
        let mut identity = Self::of_settings(config, |name| concerns(stage, name));
        let weights = config.data.all_folders().into_iter().map(|folder| folder.weight);
        let weights: Vec<f64> = weights.collect();
        // Songs that a policy generates for are drawn alike.
        if stage != Stage::ActorCritic && weights.iter().any(|&weight| weight != 1.0) {
            identity = identity.with("weights of data.folders", weights);
        }
        for base in stage.bases(config) {
            identity = identity.on(base, fingerprint(config, base)?);
        }
        Ok(identity)
    }

    /// Returns the settings that `concerns` accepts, where they differ from the published ones.
    pub(super) fn of_settings(config: &Config, concerns: impl Fn(&str) -> bool) -> Self {
        let published = flattened(&Config::published());
        let mut own = flattened(config);
        own.retain(|name, value| concerns(name) && published.get(name) != Some(value));
        Self(own)
    }

    /// Adds the weights of a stage that this one builds on.
    pub(super) fn on(mut self, base: Stage, sha256: String) -> Self {
        self.0.insert(format!("{} weights", base.name()), sha256.into());
        self
    }

    /// Adds a value.
    pub(super) fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.0.insert(name.to_owned(), value.into());
        self
    }

    /// Adds the styles that a network has columns for.
    pub(super) fn with_styles(self, styles: &[String]) -> Self {
        self.with(&format!("{DATA}styles"), styles.to_vec())
    }

    /// Adds numbers that change with the amount of data.
    fn with_amount(self, motions: &Motions<Training>) -> Self {
        let [count, frames, songs] = motions.amount();
        self.with(&format!("{DATA}motions"), count)
            .with(&format!("{DATA}frames"), frames)
            .with(&format!("{DATA}songs"), songs)
    }

    /// Returns the identity as JSON, names ascending.
    fn canonical(&self) -> String {
        Value::Object(self.0.clone().into_iter().collect()).to_string()
    }

    /// Returns the SHA-256 of the canonical JSON.
    fn hash(&self) -> String {
        sha256(self.canonical().as_bytes())
    }

    /// Adds the identity to the facts of a checkpoint.
    pub(super) fn put(&self, facts: &mut Facts) {
        facts.insert(IDENTITY.into(), self.hash());
        facts.insert(SETTINGS.into(), self.canonical());
    }

    /// Checks that a checkpoint has this identity.
    ///
    /// # Errors
    /// One line that names every setting that differs, with its old and its new value.
    pub(super) fn check(&self, facts: &Facts) -> Result<(), String> {
        if facts.get(IDENTITY) == Some(&self.hash()) {
            return Ok(());
        }
        Self::read(facts)?.compare(self)
    }

    fn read(facts: &Facts) -> Result<Self, String> {
        let settings = facts.get(SETTINGS).filter(|_| facts.contains_key(IDENTITY));
        let settings = settings.and_then(|text| serde_json::from_str(text).ok());
        settings.map(Self).ok_or_else(|| {
            "was made by another version: use another run.folder, or delete it".to_owned()
        })
    }

    fn compare(&self, now: &Self) -> Result<(), String> {
        let names: BTreeSet<&String> = self.0.keys().chain(now.0.keys()).collect();
        let published = flattened(&Config::published());
        let value = |identity: &Self, name: &str| {
            let value = identity.0.get(name).or_else(|| published.get(name));
            value.map_or_else(|| "none".to_owned(), Value::to_string)
        };
        let changes = names.into_iter().filter_map(|name| {
            let (old, new) = (value(self, name), value(now, name));
            (old != new).then(|| format!("{name} = {old}, now {new}"))
        });
        let changes: Vec<String> = changes.collect();
        match changes.is_empty() {
            true => Ok(()),
            false => Err(format!(
                "was made with {}: restore that, use another run.folder, or delete it",
                changes.join("; ")
            )),
        }
    }
}

/// Whether a stage is finished, with the settings of now; the data are not looked at.
///
/// # Errors
/// [`TrainError::State`] if it is finished with others.
pub(super) fn is_finished(config: &Config, stage: Stage) -> Result<bool, TrainError> {
    let Some(facts) = facts_of(config, stage)? else {
        return Ok(false);
    };
    let now = Identity::without_data(config, stage)?;
    let compared = Identity::read(&facts).and_then(|mut made| {
        made.0.retain(|name, _| !name.starts_with(DATA));
        made.compare(&now)
    });
    let path = checkpoint_path(&config.run, stage.name());
    compared.map(|()| true).map_err(TrainError::state(&path))
}

/// Whether the weights of a stage depend on a setting.
pub(super) fn concerns(stage: Stage, name: &str) -> bool {
    let codes = matches!(stage, Stage::Gpt | Stage::ActorCritic);
    match name {
        "data.count_periods" | "data.counts" | "data.heard_counts" | "ablation.separate_halves" => {
            return codes;
        }
        // Asked for when the finished stage is used.
        "actor_critic.enabled" | "actor_critic.kept" => return false,
        _ => {}
    }
    let section = match stage {
        Stage::VqVae => "vqvae",
        Stage::Velocity => "velocity",
        Stage::Gpt => "gpt",
        Stage::ActorCritic => "actor_critic",
    };
    let own = name.strip_prefix(section).and_then(|rest| rest.strip_prefix('.'));
    let length_or_use = ["use", "training.steps", "training.epochs"];
    SHARED.contains(&name)
        || name.starts_with("ablation.")
        || own.is_some_and(|own| !length_or_use.contains(&own))
}

/// Returns all settings by their dotted names.
#[expect(clippy::expect_used, reason = "settings are tables, strings, numbers and truth values")]
fn flattened(config: &Config) -> BTreeMap<String, Value> {
    fn collect(prefix: &str, value: Value, all: &mut BTreeMap<String, Value>) {
        match value {
            Value::Object(table) => {
                for (name, value) in table {
                    let dot = if prefix.is_empty() { "" } else { "." };
                    collect(&format!("{prefix}{dot}{name}"), value, all);
                }
            }
            value => {
                all.insert(prefix.to_owned(), value);
            }
        }
    }
    let mut all = BTreeMap::new();
    let value = serde_json::to_value(config).expect("settings can be written as JSON");
    collect("", value, &mut all);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity(text: &str, stage: Stage) -> Identity {
        let config = Config::parse(text).unwrap();
        Identity::of_settings(&config, |name| concerns(stage, name))
    }

    fn facts(identity: &Identity) -> Facts {
        let mut facts = Facts::new();
        identity.put(&mut facts);
        facts
    }

    #[test]
    fn settings_at_their_published_value_are_no_part_of_it() {
        assert_eq!(identity("", Stage::VqVae), Identity::default());
        let named = identity("[vqvae]\nwidth = 512\ncodes = 64", Stage::VqVae);
        assert_eq!(named.canonical(), r#"{"vqvae.codes":64}"#);
        // Checkpoints from before a setting existed have the identity of its default.
        assert_eq!(named.check(&facts(&named)), Ok(()));
        let hash = "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a";
        assert_eq!(Identity::default().hash(), hash, "that of an empty object");
    }

    #[test]
    fn a_mismatch_names_the_settings_with_both_values() {
        let old = identity("[vqvae]\nwidth = 192\ndecay = 0.5", Stage::VqVae);
        let new = identity("[vqvae]\nwidth = 256\n[run]\nseed = 7", Stage::VqVae);
        let message = new.check(&facts(&old)).unwrap_err();
        assert_eq!(
            message,
            "was made with run.seed = 1, now 7; vqvae.decay = 0.5, now 0.99; vqvae.width = 192, \
             now 256: restore that, use another run.folder, or delete it"
        );
        let older = Facts::from([("settings".into(), "VqVaeConfig { .. }".into())]);
        assert!(new.check(&older).unwrap_err().contains("another version"));
    }

    #[test]
    fn a_stage_depends_on_its_own_section_but_not_on_its_length_or_use() {
        let text = "[vqvae]\nuse = \"best\"\n[vqvae.training]\nsteps = 7\nepochs = 3\n\
                    [gpt]\nheads = 6\n[actor_critic]\nkept = 0.5\nenabled = false";
        assert_eq!(identity(text, Stage::VqVae), Identity::default());
        assert_eq!(identity(text, Stage::Gpt).canonical(), r#"{"gpt.heads":6}"#);
        assert_eq!(identity(text, Stage::ActorCritic), Identity::default());
    }

    #[test]
    fn ablations_belong_to_the_stages_that_they_change() {
        for flag in ["whole_body", "root_in_pose", "continuous"] {
            let text = format!("[ablation]\n{flag} = true\n[actor_critic]\nenabled = false");
            let wanted = format!("{{\"ablation.{flag}\":true}}");
            assert_eq!(identity(&text, Stage::VqVae).canonical(), wanted);
        }
        // The VQ-VAE can be shared with the whole model.
        let separate = "[ablation]\nseparate_halves = true";
        assert_eq!(identity(separate, Stage::VqVae), Identity::default());
        for stage in [Stage::Gpt, Stage::ActorCritic] {
            assert_ne!(identity(separate, stage), Identity::default());
        }
    }
}
