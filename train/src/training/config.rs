//! Settings of a run, read from TOML over the published ones.

use std::path::{Path, PathBuf};

use bailando::{
    features::Profile,
    model::{MAX_CANDIDATES, MAX_COUNT_PERIODS, MAX_GUIDANCE, MAX_TEMPERATURE, WeightStorage},
    motion::MotionFrame,
};
use serde::{Deserialize, Serialize};

use super::{AblationConfig, TrainError, reward::BeatReward};
use crate::data::{JOINTS, PHASES};
use crate::nn::Precision;

/// The file that says every setting, with a comment on each.
const BASE: &str = include_str!("../../presets/paper.toml");

/// Everything that a run can be told; `train/presets/paper.toml` explains every field.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the commented preset is the documentation")]
pub struct Config {
    pub data: DataConfig,
    pub run: RunConfig,
    pub vqvae: VqVaeConfig,
    pub velocity: VelocityConfig,
    pub gpt: GptConfig,
    pub actor_critic: ActorCriticConfig,
    pub adapt: AdaptConfig,
    pub ablation: AblationConfig,
    pub export: ExportConfig,
}

/// Where motion and music come from.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the commented preset is the documentation")]
pub struct DataConfig {
    pub folder: PathBuf,
    pub profile: Profile,
    pub audio: PathBuf,
    pub cache: PathBuf,
    pub frame: MotionFrame,
    pub mirror: bool,
    pub phases: usize,
    pub count_periods: Vec<u32>,
}

impl DataConfig {
    /// Motion columns that the root's decoder gives.
    pub(super) fn root_columns(&self) -> &'static [usize] {
        match self.frame {
            MotionFrame::World => &[0, 1, 2],
            MotionFrame::Dancer => &[0, 1, 2, 3 * JOINTS],
        }
    }

    /// Folder of the songs, where they are kept apart.
    pub(super) fn audio_folder(&self) -> Option<&Path> {
        Some(self.audio.as_path()).filter(|folder| !folder.as_os_str().is_empty())
    }

    /// Folder of the music features, where it is not the usual one.
    pub(super) fn cache_folder(&self) -> Option<&Path> {
        Some(self.cache.as_path()).filter(|folder| !folder.as_os_str().is_empty())
    }
}

/// Where and how a run happens.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    pub folder: PathBuf,
    pub device: String,
    pub precision: Precision,
    pub seed: u64,
    pub checkpoint_seconds: f64,
    pub log_steps: u64,
    pub test_steps: u64,
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
    pub training: TrainingConfig,
    #[serde(rename = "use")]
    pub keep: Keep,
}

/// Stage `velocity`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VelocityConfig {
    pub frames: usize,
    pub stride: usize,
    pub difference_weight: f64,
    pub training: TrainingConfig,
    #[serde(rename = "use")]
    pub keep: Keep,
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
    pub slip_share: f64,
    pub slip_frames: usize,
    pub hear: Hear,
    pub standardise_music: bool,
    pub training: TrainingConfig,
    #[serde(rename = "use")]
    pub keep: Keep,
}

/// Which music columns the GPT is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Hear {
    /// All, as published.
    All,
    /// Onsets, beats and counts. Few songs are told apart by timbre and harmony alone, and a new one
    /// sounds like none of them.
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
    pub codes: usize,
    pub actor_steps: u64,
    pub critic_steps: u64,
    pub critic_warmup_steps: u64,
    pub training: TrainingConfig,
}

/// Stage `adapt`; what is not said here is as in `actor_critic`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdaptConfig {
    pub pieces_per_epoch: usize,
    pub codes: usize,
    pub training: TrainingConfig,
}

/// Length and optimiser of a stage.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the commented preset is the documentation")]
pub struct TrainingConfig {
    pub batch: usize,
    pub epochs: u64,
    pub steps: u64,
    pub rate: f64,
    pub betas: [f64; 2],
    pub schedule: Schedule,
    pub milestones: Vec<f64>,
    pub factor: f64,
    pub warmup_steps: u64,
    pub clip: f64,
}

/// Which weights of a finished stage are used afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Keep {
    /// Those of the last step.
    Last,
    /// Those with the lowest test loss.
    Best,
}

/// How the learning rate falls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// By `factor` at each of `milestones`.
    Milestones,
    /// Along half a cosine down to `factor`.
    Cosine,
}

/// Stage `export`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExportConfig {
    pub folder: PathBuf,
    pub name: String,
    pub licence: String,
    pub root_height: f32,
    pub temperature: f32,
    pub guidance: f32,
    pub candidates: usize,
    pub weights: WeightStorage,
}

impl Config {
    /// Reads a file, laid over the published settings.
    ///
    /// # Errors
    /// [`TrainError`] names the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, TrainError> {
        let text = std::fs::read_to_string(path).map_err(TrainError::file(path))?;
        Self::parse(&text).map_err(|message| TrainError::Config {
            path: path.to_owned(),
            message,
        })
    }

    /// Reads settings, laid over the published ones.
    ///
    /// # Errors
    /// One line on what is wrong.
    pub fn parse(text: &str) -> Result<Self, String> {
        let table = |text: &str| {
            text.parse::<toml::Table>()
                .map_err(|error| error.to_string())
        };
        let mut settings = table(BASE)?;
        overlay(&mut settings, table(text)?);
        let config: Self = settings.try_into().map_err(|error| error.to_string())?;
        config.check()?;
        Ok(config)
    }

    fn check(&self) -> Result<(), String> {
        let stages = [
            ("vqvae", &self.vqvae.training),
            ("velocity", &self.velocity.training),
            ("gpt", &self.gpt.training),
            ("actor_critic", &self.actor_critic.training),
            ("adapt", &self.adapt.training),
        ];
        for (stage, training) in stages {
            training
                .check()
                .map_err(|message| format!("{stage}.training: {message}"))?;
        }
        self.export.check()?;
        let crops = [
            ("vqvae", self.vqvae.frames, self.vqvae.stride),
            ("velocity", self.velocity.frames, self.velocity.stride),
        ];
        for (stage, frames, stride) in crops {
            if frames == 0 || !frames.is_multiple_of(super::FRAMES_PER_CODE) || stride == 0 {
                return Err(format!(
                    "{stage}: frames ({frames}) must be a multiple of 8 and stride ({stride}) at least 1"
                ));
            }
        }
        let phases = self.data.phases;
        if phases == 0 || phases > PHASES {
            return Err(format!("data.phases ({phases}) must lie in 1..={PHASES}"));
        }
        let counts = &self.data.count_periods;
        if counts.contains(&0) || counts.len() > MAX_COUNT_PERIODS {
            return Err(format!(
                "data.count_periods: at most {MAX_COUNT_PERIODS}, each at least 1"
            ));
        }
        if !counts.is_empty() && self.data.profile != Profile::Librosa011 {
            return Err("data.count_periods need the profile librosa-0.11".into());
        }
        let gpt = &self.gpt;
        if gpt.phases > phases {
            return Err(format!(
                "gpt.phases ({}) must lie in 0..={phases}, the phases of [data]",
                gpt.phases
            ));
        }
        if gpt.heads == 0 || !gpt.channels.is_multiple_of(gpt.heads) {
            let (channels, heads) = (gpt.channels, gpt.heads);
            return Err(format!(
                "gpt: {channels} channels cannot be divided among {heads} heads"
            ));
        }
        self.actor_critic
            .check()
            .map_err(|message| format!("actor_critic: {message}"))?;
        self.ablation
            .check(self.actor_critic.enabled)
            .map_err(|message| format!("ablation: {message}"))?;
        let sizes = [
            ("vqvae.width", self.vqvae.width),
            ("vqvae.embedding", self.vqvae.embedding),
            ("vqvae.codes", self.vqvae.codes),
            ("gpt.channels", gpt.channels),
            ("gpt.block", gpt.block),
            ("gpt.stride", gpt.stride),
            ("gpt.base_layers", gpt.base_layers),
            ("adapt.pieces_per_epoch", self.adapt.pieces_per_epoch),
        ];
        match sizes.into_iter().find(|&(_, size)| size == 0) {
            Some((name, _)) => Err(format!("{name} must be at least 1")),
            None if !(0.0..1.0).contains(&gpt.dropout) => {
                Err(format!("gpt.dropout ({}) must lie in 0..1", gpt.dropout))
            }
            None if !(0.0..1.0).contains(&gpt.code_noise) => Err(format!(
                "gpt.code_noise ({}) must lie in 0..1",
                gpt.code_noise
            )),
            None if !(0.0..=1.0).contains(&gpt.slip_share) => Err(format!(
                "gpt.slip_share ({}) must lie in 0..=1",
                gpt.slip_share
            )),
            None if gpt.slip_share > 0.0 && gpt.slip_frames == 0 => {
                Err("gpt.slip_frames must be at least 1 where there are slips".into())
            }
            None if self.ablation.continuous && gpt.code_noise + gpt.slip_share > 0.0 => Err(
                "gpt.code_noise, gpt.slip_share: with ablation.continuous there are no codes"
                    .into(),
            ),
            None if self.run.log_steps == 0 => Err("run.log_steps must be at least 1".into()),
            None => Ok(()),
        }
    }
}

impl Config {
    /// Start phases that the GPT learns from.
    pub(super) fn gpt_phases(&self) -> usize {
        match self.gpt.phases {
            0 => self.data.phases,
            phases => phases,
        }
    }
}

impl ActorCriticConfig {
    fn check(&self) -> Result<(), String> {
        if self.actor_steps == 0 || self.critic_steps == 0 || self.critic_layers == 0 {
            return Err("actor_steps, critic_steps and critic_layers must be at least 1".into());
        }
        let weights = [
            ("beat_weight", self.beat_weight),
            ("consistency_weight", self.consistency_weight),
            ("discount", self.discount),
            ("trace", self.trace),
            ("entropy_weight", self.entropy_weight),
            ("divergence_weight", self.divergence_weight),
            ("temperature", self.temperature),
        ];
        let wrong = weights
            .into_iter()
            .find(|(_, value)| !(*value >= 0.0 && value.is_finite()));
        wrong.map_or(Ok(()), |(name, value)| {
            Err(format!("{name} ({value}) must be a number of 0 or more"))
        })
    }
}

impl ExportConfig {
    /// What a manifest would be refused for after all the training.
    fn check(&self) -> Result<(), String> {
        let numbers = [
            ("temperature", self.temperature, MAX_TEMPERATURE),
            ("guidance", self.guidance, MAX_GUIDANCE),
        ];
        for (name, value, most) in numbers {
            if !(0.0..=most).contains(&value) {
                return Err(format!("export.{name} ({value}) must lie in 0..={most}"));
            }
        }
        if !(1..=MAX_CANDIDATES).contains(&self.candidates) {
            let candidates = self.candidates;
            return Err(format!(
                "export.candidates ({candidates}) must lie in 1..={MAX_CANDIDATES}"
            ));
        }
        Ok(())
    }
}

impl TrainingConfig {
    fn check(&self) -> Result<(), String> {
        if self.batch == 0 || (self.steps == 0 && self.epochs == 0) {
            return Err("batch and one of steps and epochs must be at least 1".into());
        }
        if !(self.rate > 0.0 && self.rate.is_finite()) {
            return Err(format!("rate ({}) must be above 0", self.rate));
        }
        if self.betas.iter().any(|beta| !(0.0..1.0).contains(beta)) {
            return Err(format!("betas ({:?}) must lie in 0..1", self.betas));
        }
        Ok(())
    }

    /// Steps of the whole stage over `windows` different windows.
    pub(super) fn total_steps(&self, windows: usize) -> u64 {
        if self.steps > 0 {
            return self.steps;
        }
        (self.epochs * windows as u64).div_ceil(self.batch as u64)
    }

    /// The learning rate of a step out of `total`.
    pub(super) fn rate_at(&self, step: u64, total: u64) -> f64 {
        let share = step as f64 / total.max(1) as f64;
        let fall = match self.schedule {
            Schedule::Milestones => {
                let passed = self
                    .milestones
                    .iter()
                    .filter(|&&milestone| share >= milestone);
                self.factor.powi(passed.count() as i32)
            }
            Schedule::Cosine => {
                let wave = 0.5 * (1.0 + (std::f64::consts::PI * share).cos());
                self.factor + (1.0 - self.factor) * wave
            }
        };
        let warm = (step + 1) as f64 / (self.warmup_steps + 1) as f64;
        self.rate * fall * warm.min(1.0)
    }
}

/// Replaces values of `base` by those of `other`, table by table.
fn overlay(base: &mut toml::Table, other: toml::Table) {
    for (key, value) in other {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(value)) => overlay(base, value),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_read() {
        let presets = [
            BASE,
            include_str!("../../presets/default.toml"),
            include_str!("../../presets/tiny.toml"),
            include_str!("../../presets/ablation.toml"),
        ];
        let widths = presets.map(|text| Config::parse(text).unwrap().vqvae.width);
        assert_eq!(widths, [512, 192, 16, 48]);
    }

    #[test]
    fn a_file_changes_only_what_it_says() {
        let config = Config::parse("[vqvae.training]\nrate = 0.5").unwrap();
        assert_eq!(config.vqvae.training.rate, 0.5);
        assert_eq!(config.vqvae.training.batch, 32);
        assert_eq!(config.gpt.training.rate, 3e-4);
    }

    #[test]
    fn mistakes_are_refused() {
        for text in [
            "[vqvae]\nwidht = 3",
            "[vqvae]\nuse = \"first\"",
            "[vqvae]\nframes = 60",
            "[data]\nphases = 9",
            "[data]\ncount_periods = [4, 0]",
            "[data]\ncount_periods = [4]\nprofile = \"librosa-0.8.1\"",
            "[data]\nframe = \"sideways\"",
            "[gpt]\nheads = 5",
            "[gpt]\nphases = 2",
            "[gpt]\ncode_noise = 1.0",
            "[gpt]\nslip_share = 1.5\nslip_frames = 4",
            "[gpt]\nslip_share = 0.5",
            "[gpt.training]\nrate = 0",
            "[actor_critic]\nactor_steps = 0",
            "[actor_critic]\ntemperature = -1.0",
            "[export]\ntemperature = 11.0",
            "[export]\nguidance = -0.5",
            "[export]\ncandidates = 0",
            "[adapt]\npieces_per_epoch = 0",
            "[ablation]\nseparate_halves = true\nwhole_body = true",
            "[ablation]\ncontinuous = true",
            "[gpt.training]\nbetas = [1.0, 0.9]",
        ] {
            assert!(Config::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn rates_fall_as_scheduled() {
        let mut training = Config::parse("").unwrap().vqvae.training;
        training.rate = 1.0;
        let rates = [0, 19, 20, 40].map(|step| training.rate_at(step, 100));
        for (rate, wanted) in rates.into_iter().zip([1.0, 1.0, 0.1, 0.01]) {
            assert!((rate - wanted).abs() < 1e-12);
        }
        training.schedule = Schedule::Cosine;
        assert!((training.rate_at(50, 100) - 0.55).abs() < 1e-12);
        training.warmup_steps = 9;
        assert!((training.rate_at(0, 100) - 0.1).abs() < 1e-3);
    }
}
