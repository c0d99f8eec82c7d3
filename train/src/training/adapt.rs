//! Stage `adapt`, "choreograph in the wild" (paper section 3.3): the policy learns further for one
//! song, for which no motion is needed.

use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
};

use bailando::model::{Manifest, file_sha256};

use super::{
    actor_critic::{RewardTask, learn_from_rewards},
    checkpoint::Checkpoint,
    config::{ActorCriticConfig, Config, RunConfig},
    decode::motion_weights,
    device::on_device,
    error::TrainError,
    expert::expert_dances,
    export,
    identity::{Identity, concerns},
    imitate::{ImitationTask, imitate},
    kept::{checkpoint_path, fingerprint, read_finished},
    policy::Policy,
    runner::{Limits, Outcome},
    served::ServedModel,
    song::Song,
    stage::Stage,
};
use crate::weights::MotionWeights;

const STAGE: &str = "adapt";
/// Digits of the song's hash in its folder's name.
const DIGITS: usize = 16;

/// A song to adapt to, the model to start from, and where the stage's files are.
pub struct Adaptation {
    /// The song's features and beats.
    song: Song,
    /// The model directory to start from; none starts from the run.
    model: Option<ServedModel>,
    /// `run.folder/adapted/<hash of the audio file and the model>`: the same file resumes, under
    /// any name.
    pub folder: PathBuf,
    /// The audio file.
    path: PathBuf,
}

impl Adaptation {
    /// Adapts `model`, else the run of `config`, to the audio file `path`, whose features are
    /// `song`.
    ///
    /// # Errors
    /// [`TrainError::File`] if it cannot be read.
    pub fn new(
        config: &Config,
        path: &Path,
        song: Song,
        model: Option<ServedModel>,
    ) -> Result<Self, TrainError> {
        let hash = File::open(path).and_then(|mut file| file_sha256(&mut file));
        let hash = hash.map_err(TrainError::file(path))?;
        let digits = |hash: &str| hash.chars().take(DIGITS).collect::<String>();
        let mut place = digits(&hash);
        if let Some(model) = &model {
            place = format!("{place}-{}", digits(model.sha256()));
        }
        Ok(Self {
            song,
            model,
            folder: config.run.folder.join("adapted").join(place),
            path: path.to_owned(),
        })
    }

    fn run(&self, config: &Config) -> RunConfig {
        RunConfig { folder: self.folder.clone(), ..config.run.clone() }
    }

    /// Imitates the model's own dances to the song, the best of some candidates.
    fn imitate(
        &self,
        config: &Config,
        model: &ServedModel,
        limits: Limits,
        output: &mut impl Write,
    ) -> Result<Outcome, TrainError> {
        let (settings, seed) = (&config.adapt, config.run.seed);
        let identity =
            Identity::of_settings(config, concerns_imitation).with("model", model.sha256());
        self.check(config, &identity)?;
        let places = (model, self.path.as_path(), self.folder.as_path());
        let dances = expert_dances(settings, places, seed, output)?;
        // From any other code it would first have to find one of the dances.
        let policy = Policy { starts: dances.starts(), ..model.policy() };
        let (run, temperature) = (self.run(config), model.temperature());
        let task = ImitationTask {
            name: STAGE,
            identity,
            run: &run,
            temperature: f64::from(temperature),
            music: policy.conditioned(&self.song.rows, dances.style.as_deref()),
            policy,
            dances: dances.codes,
        };
        on_device!(config.run.device.as_str(), |A, device| {
            imitate::<A>(config, task, &device, limits, output)
        })
    }

    /// Refuses a song that is too short, and other settings than an earlier adaptation had, before
    /// minutes are spent on dances.
    fn check(&self, config: &Config, identity: &Identity) -> Result<(), TrainError> {
        let (rows, least) = (self.song.rows.nrows(), config.gpt.block + 1);
        if rows < least {
            let message = format!("the song has {rows} rows of music, a window needs {least}");
            return Err(TrainError::Data { path: self.path.clone(), message });
        }
        let path = checkpoint_path(&self.run(config), STAGE);
        match Checkpoint::read_facts(&path)? {
            Some(facts) => identity.check(&facts).map_err(TrainError::state(&path)),
            None => Ok(()),
        }
    }

    /// Learns from rewards, as `actor-critic` does.
    fn learn(
        &self,
        config: &Config,
        init: Option<&Path>,
        limits: Limits,
        output: &mut impl Write,
    ) -> Result<Outcome, TrainError> {
        let run = self.run(config);
        let stage = ActorCriticConfig {
            pieces_per_epoch: config.adapt.pieces_per_epoch,
            codes: config.adapt.codes,
            training: config.adapt.training.clone(),
            ..config.actor_critic.clone()
        };
        let own = Config { actor_critic: stage.clone(), ..config.clone() };
        let identity = Identity::of_settings(&own, |name| concerns(Stage::ActorCritic, name));
        let (policy, motion, identity) = self.start(config, identity)?;
        let task = RewardTask {
            name: STAGE,
            identity,
            run: &run,
            stage: &stage,
            policy,
            motion,
            init,
            songs: std::slice::from_ref(&self.song),
        };
        on_device!(config.run.device.as_str(), |A, device| {
            learn_from_rewards::<A>(config, task, &device, limits, output)
        })
    }

    /// Returns what the rewards change, what decodes it, and the identity with its weights.
    fn start(
        &self,
        config: &Config,
        identity: Identity,
    ) -> Result<(Policy, MotionWeights, Identity), TrainError> {
        if let Some(model) = &self.model {
            let identity = identity.with("model", model.sha256());
            return Ok((model.policy(), model.motion().clone(), identity));
        }
        let base = Policy::latest_stage(config)?;
        let identity = identity
            .on(base, fingerprint(config, base)?)
            .with("actor_critic.kept", config.actor_critic.kept);
        Ok((Policy::latest(config)?, motion_weights(config)?, identity))
    }
}

/// Whether an imitation depends on a setting.
fn concerns_imitation(name: &str) -> bool {
    let others =
        ["adapt.training.steps", "adapt.training.epochs", "adapt.pieces_per_epoch", "adapt.codes"];
    name == "run.seed" || name.starts_with("adapt.") && !others.contains(&name)
}

/// Adapts a policy to a song: by imitating its own dances to it, the best of some candidates, or by
/// their rewards where there are no candidates or no model directory. `init` is an official
/// checkpoint that gives the critic to start from.
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
    match &adaptation.model {
        Some(model) if config.adapt.candidates > 0 => {
            adaptation.imitate(config, model, limits, output)
        }
        _ => adaptation.learn(config, init, limits, output),
    }
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
    let checkpoint = read_finished(&adaptation.run(config), STAGE, &config.adapt.training)?;
    let path = checkpoint_path(&adaptation.run(config), STAGE);
    let state = TrainError::state(&path);
    let name = adaptation.path.file_name().unwrap_or_default().to_string_lossy();
    let facts = [("adapted_to", name.into_owned().into())];
    match &adaptation.model {
        Some(model) => {
            let policy = model.policy().with_weights(&checkpoint).map_err(state)?;
            let facts = facts.map(|(name, value)| (name.to_owned(), value));
            model.write((folder, replace), &policy, facts)
        }
        None => {
            let policy = Policy::restore(config, &checkpoint).map_err(state)?;
            export::write(config, folder, policy, replace, facts)
        }
    }
}
