//! Stage `adapt`, "choreograph in the wild" (paper section 3.3): the policy learns further from the
//! rewards of one song, for which no motion is needed.

use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
};

use bailando::model::{Manifest, file_sha256};

use super::{
    actor_critic::{RewardTask, learn_from_rewards},
    config::{ActorCriticConfig, Config, RunConfig},
    device::on_device,
    error::TrainError,
    export,
    identity::{Identity, concerns},
    kept::fingerprint,
    policy::Policy,
    runner::{Limits, Outcome},
    song::Song,
    stage::Stage,
};

const STAGE: &str = "adapt";
/// Digits of the song's hash in its folder's name.
const DIGITS: usize = 16;

/// A song to adapt to, and where the stage's files are.
pub struct Adaptation {
    /// The song's features and beats.
    pub song: Song,
    /// `run.folder/adapted/<hash of the audio file>`: the same file resumes, under any name.
    pub folder: PathBuf,
    /// Name of the audio file.
    pub name: String,
}

impl Adaptation {
    /// Adapts to the audio file `path`, whose features are `song`.
    ///
    /// # Errors
    /// [`TrainError::File`] if it cannot be read.
    pub fn new(config: &Config, path: &Path, song: Song) -> Result<Self, TrainError> {
        let hash = File::open(path).and_then(|mut file| file_sha256(&mut file));
        let hash = hash.map_err(TrainError::file(path))?;
        let digits: String = hash.chars().take(DIGITS).collect();
        let name = path.file_name().map(|name| name.to_string_lossy());
        Ok(Self {
            song,
            folder: config.run.folder.join("adapted").join(digits),
            name: name.map_or_else(String::new, Into::into),
        })
    }

    fn run(&self, config: &Config) -> RunConfig {
        RunConfig { folder: self.folder.clone(), ..config.run.clone() }
    }
}

/// Adapts the run's latest policy to a song. `init` is an official checkpoint that gives the critic
/// to start from.
///
/// # Errors
/// Any [`TrainError`]; the last checkpoint stays.
pub fn adapt(
    config: &Config,
    adaptation: &Adaptation,
    init: Option<&Path>,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    config.ablation.refuse("adapt")?;
    let run = adaptation.run(config);
    let stage = ActorCriticConfig {
        pieces_per_epoch: config.adapt.pieces_per_epoch,
        codes: config.adapt.codes,
        training: config.adapt.training.clone(),
        ..config.actor_critic.clone()
    };
    let base = Policy::latest_stage(config)?;
    let own = Config { actor_critic: stage.clone(), ..config.clone() };
    let identity = Identity::of_settings(&own, |name| concerns(Stage::ActorCritic, name))
        .on(base, fingerprint(config, base)?)
        .with("actor_critic.kept", config.actor_critic.kept);
    let task = RewardTask {
        name: STAGE,
        identity,
        run: &run,
        stage: &stage,
        policy: Policy::latest(config)?,
        init,
        songs: std::slice::from_ref(&adaptation.song),
    };
    on_device!(config.run.device.as_str(), |A, device| {
        learn_from_rewards::<A>(config, task, &device, limits, output)
    })
}

/// Writes the model directory of a finished adaptation.
///
/// # Errors
/// [`TrainError::StageMissing`] where it is not finished; what cannot be read or written.
pub fn export_adapted(
    config: &Config,
    adaptation: &Adaptation,
    folder: &Path,
    replace: bool,
) -> Result<Manifest, TrainError> {
    let policy = Policy::of_folder(config, &adaptation.run(config), STAGE, &config.adapt.training)?;
    let facts = [("adapted_to", adaptation.name.clone().into())];
    export::write(config, folder, policy, replace, facts)
}
