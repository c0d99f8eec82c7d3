//! Settings of a run, read from TOML over the published ones.

use std::path::{Path, PathBuf};

use bailando::{
    features::Profile,
    model::{CountSource, MAX_COUNT_PERIODS},
    motion::MotionFrame,
};
use serde::{Deserialize, Serialize};

use self::checks::{not_negative, within, within_range};
pub use self::{
    ablation::AblationConfig,
    optimiser::{Schedule, TrainingConfig},
    stages::CheckpointPolicy,
};
pub(super) use self::{
    balance::BalanceConfig,
    export::ExportConfig,
    stages::{
        ActorCriticConfig, AdaptConfig, GptConfig, MusicColumns, VelocityConfig, VqVaeConfig,
    },
};
use super::error::TrainError;
use crate::data::{DataFolder, JOINTS, OpenOptions, PHASES};

mod ablation;
mod balance;
mod checks;
mod export;
mod optimiser;
mod stages;

/// The file that has every setting, with a comment on each.
const BASE: &str = include_str!("../../../presets/paper.toml");

/// Every setting of a run; `train/presets/paper.toml` explains every field.
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
    pub folders: Vec<DataFolder>,
    pub profile: Profile,
    pub audio: PathBuf,
    pub cache: PathBuf,
    pub frame: MotionFrame,
    pub mirror: bool,
    pub phases: usize,
    pub count_periods: Vec<u32>,
    pub counts: CountSource,
    pub heard_counts: f64,
}

impl DataConfig {
    /// Returns the motion columns that the root's decoder gives.
    pub(super) fn root_columns(&self) -> &'static [usize] {
        match self.frame {
            MotionFrame::World => &[0, 1, 2],
            MotionFrame::Dancer => &[0, 1, 2, 3 * JOINTS],
        }
    }

    fn check(&self) -> Result<(), String> {
        let Self { phases, count_periods, .. } = self;
        let wrong = |folder: &&DataFolder| !(folder.weight > 0.0 && folder.weight.is_finite());
        if let Some(DataFolder { path, weight }) = self.folders.iter().find(wrong) {
            let path = path.display();
            return Err(format!("folders: the weight of {path} ({weight}) must be above 0"));
        }
        if !(1..=PHASES).contains(phases) {
            return Err(format!("phases ({phases}) must lie in 1..={PHASES}"));
        }
        if count_periods.contains(&0) || count_periods.len() > MAX_COUNT_PERIODS {
            return Err(format!("count_periods: at most {MAX_COUNT_PERIODS}, each at least 1"));
        }
        if !count_periods.is_empty() && self.profile != Profile::Librosa011 {
            return Err("count_periods need the profile librosa-0.11".into());
        }
        within_range([("heard_counts", self.heard_counts)], 0.0..=1.0, "0..=1")?;
        Ok(())
    }

    /// Returns every data folder with its weight.
    pub(crate) fn all_folders(&self) -> Vec<DataFolder> {
        match self.folders.is_empty() {
            true => vec![DataFolder { path: self.folder.clone(), weight: 1.0 }],
            false => self.folders.clone(),
        }
    }

    /// Replaces the data folders, none of them changes nothing; the first keeps the weight of what
    /// was the first, and so on.
    pub(crate) fn replace_folders(&mut self, paths: &[PathBuf]) {
        if paths.is_empty() {
            return;
        }
        let weights = self.all_folders().into_iter().map(|folder| folder.weight);
        let weights = weights.chain(std::iter::repeat(1.0));
        let folders = paths.iter().cloned().zip(weights);
        self.folders = folders.map(|(path, weight)| DataFolder { path, weight }).collect();
    }

    /// Returns how the data folders are opened.
    pub(crate) fn open_options(&self) -> OpenOptions {
        OpenOptions { audio: self.audio_folder().map(Into::into) }
    }

    /// Returns the folder of the songs, where they are kept apart.
    fn audio_folder(&self) -> Option<&Path> {
        Some(self.audio.as_path()).filter(|folder| !folder.as_os_str().is_empty())
    }

    /// Returns the folder of the music features, where it is not the usual one.
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
    pub seed: u64,
    pub checkpoint_seconds: f64,
    pub log_steps: u64,
    pub test_steps: u64,
}

impl RunConfig {
    fn check(&self) -> Result<(), String> {
        if self.log_steps == 0 {
            return Err("log_steps must be at least 1".into());
        }
        not_negative([("checkpoint_seconds", self.checkpoint_seconds)])
    }
}

impl Config {
    /// Reads a file, laid over the published settings.
    ///
    /// # Errors
    /// [`TrainError`] names the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, TrainError> {
        let text = std::fs::read_to_string(path).map_err(TrainError::file(path))?;
        Self::parse(&text).map_err(|message| TrainError::Config { path: path.to_owned(), message })
    }

    /// Reads settings, laid over the published ones.
    ///
    /// # Errors
    /// One line on what is wrong.
    pub fn parse(text: &str) -> Result<Self, String> {
        let table = |text: &str| text.parse::<toml::Table>().map_err(|error| error.to_string());
        let mut settings = table(BASE)?;
        overlay(&mut settings, table(text)?);
        let config: Self = settings.try_into().map_err(|error| error.to_string())?;
        config.check()?;
        Ok(config)
    }

    /// Returns the published settings.
    #[expect(clippy::expect_used, reason = "a file of this crate, which a test reads")]
    pub(super) fn published() -> Self {
        Self::parse("").expect("the published settings are valid")
    }

    fn check(&self) -> Result<(), String> {
        let trainings = [
            ("vqvae", &self.vqvae.training),
            ("velocity", &self.velocity.training),
            ("gpt", &self.gpt.training),
            ("actor_critic", &self.actor_critic.training),
            ("adapt", &self.adapt.training),
        ];
        for (stage, training) in trainings {
            within(&format!("{stage}.training: "), training.check())?;
        }
        within("data.", self.data.check())?;
        within("vqvae.", self.vqvae.check())?;
        within("velocity.", self.velocity.check())?;
        within("gpt.", self.gpt.check(self.data.phases))?;
        within("actor_critic.", self.actor_critic.check())?;
        within("adapt.", self.adapt.check())?;
        within("export.", self.export.check())?;
        within("ablation: ", self.ablation.check(self.actor_critic.enabled))?;
        if self.ablation.continuous && self.gpt.code_noise + self.gpt.shift_share > 0.0 {
            return Err(
                "gpt.code_noise, gpt.slip_share: with ablation.continuous there are no codes"
                    .into(),
            );
        }
        within("run.", self.run.check())
    }

    /// Returns the number of start phases that the GPT learns from.
    pub(super) fn gpt_phases(&self) -> usize {
        match self.gpt.phases {
            0 => self.data.phases,
            phases => phases,
        }
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
            include_str!("../../../presets/default.toml"),
            include_str!("../../../presets/tiny.toml"),
            include_str!("../../../presets/ablation.toml"),
            include_str!("../../../presets/styles.toml"),
        ];
        let widths = presets.map(|text| Config::parse(text).unwrap().vqvae.width);
        assert_eq!(widths, [512, 192, 16, 48, 192]);
    }

    #[test]
    fn a_file_changes_only_what_it_says() {
        let config = Config::parse("[vqvae.training]\nrate = 0.5").unwrap();
        assert_eq!(config.vqvae.training.rate, 0.5);
        assert_eq!(config.vqvae.training.batch, 32);
        assert_eq!(config.gpt.training.rate, 3e-4);
    }

    #[test]
    fn folders_of_the_command_line_replace_those_of_the_settings_and_keep_their_weights() {
        let text = "[[data.folders]]\npath = \"a\"\nweight = 3.0\n[[data.folders]]\npath = \"b\"";
        let mut data = Config::parse(text).unwrap().data;
        let folders = |data: &DataConfig| -> Vec<(String, f64)> {
            let folders = data.all_folders().into_iter();
            folders.map(|folder| (folder.path.display().to_string(), folder.weight)).collect()
        };
        data.replace_folders(&[]);
        assert_eq!(folders(&data), [("a".into(), 3.0), ("b".into(), 1.0)]);
        data.replace_folders(&["c", "d", "e"].map(PathBuf::from));
        assert_eq!(folders(&data), [("c".into(), 3.0), ("d".into(), 1.0), ("e".into(), 1.0)]);
        let mut one = Config::parse("[data]\nfolder = \"x\"").unwrap().data;
        assert_eq!(folders(&one), [("x".into(), 1.0)]);
        one.replace_folders(&[PathBuf::from("y")]);
        assert_eq!(folders(&one), [("y".into(), 1.0)]);
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
            "[[data.folders]]\npath = \"a\"\nweight = 0.0",
            "[[data.folders]]\nweight = 1.0",
            "[vqvae.balance]\nstyles = 1.5",
            "[velocity.balance]\nphrases = -0.5",
            "[gpt.balance]\nstill = 1.1",
            "[gpt.balance]\ndamaged = nan",
            "[gpt]\nstyle_drop = 1.5",
            "[gpt]\nrecombine = -0.1",
            "[run]\nlog_steps = 0",
            "[run]\ncheckpoint_seconds = nan",
            "[vqvae]\nvelocity_weight = -1.0",
            "[vqvae]\nacceleration_weight = nan",
            "[vqvae]\ncommitment = -0.1",
            "[vqvae]\nrestart_below = inf",
            "[vqvae]\ndecay = 1.0",
            "[vqvae]\ndecay = nan",
            "[velocity]\ndifference_weight = -1.0",
            "[velocity]\nspeed_weight = -1.0",
            "[velocity]\ncontact_weight = 1.0",
            "[velocity]\nenergy_weight = 1.0",
            "[vqvae]\ncontact_weight = -1.0",
            "[gpt]\nheads = 5",
            "[gpt]\nphases = 2",
            "[gpt]\ncode_noise = 1.0",
            "[gpt]\nslip_share = 1.5\nslip_frames = 4",
            "[gpt]\nslip_share = 0.5",
            "[gpt.training]\nrate = 0",
            "[actor_critic]\nactor_steps = 0",
            "[actor_critic]\ntemperature = -1.0",
            "[actor_critic]\nslow_weight = nan",
            "[actor_critic]\ntakes = 0",
            "[actor_critic]\ncontinued = 1.5",
            "[actor_critic]\nkept = -0.1",
            "[adapt.training]\nclip = nan",
            "[vqvae.training]\nfactor = -0.1",
            "[gpt.training]\nmilestones = [0.5, 100.0]",
            "[export]\nroot_height = nan",
            "[export]\ntemperature = 11.0",
            "[export]\nguidance = -0.5",
            "[export]\ncandidates = 0",
            "[export]\nhop = 0",
            "[export]\nlowest_pelvis = -0.1",
            "[adapt]\npieces_per_epoch = 0",
            "[adapt]\ncandidates = 17",
            "[adapt]\ndances = 0",
            "[adapt]\nstride = 0",
            "[adapt]\ndivergence_weight = nan",
            "[ablation]\nseparate_halves = true\nwhole_body = true",
            "[ablation]\ncontinuous = true",
            "[gpt.training]\nbetas = [1.0, 0.9]",
        ] {
            assert!(Config::parse(text).is_err(), "{text}");
        }
    }
}
