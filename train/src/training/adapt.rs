//! Stage `adapt`, "choreograph in the wild" (paper section 3.3): the policy learns further for
//! songs that no motion is needed for.

use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
};

use bailando::model::{Manifest, file_sha256};
use serde_json::Value;

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
    imitate::{ImitatedSong, ImitationTask, imitate},
    kept::{checkpoint_path, fingerprint, read_finished},
    policy::Policy,
    runner::{Limits, Outcome},
    served::ServedModel,
    song::Song,
    stage::Stage,
};
use crate::{sha256, weights::MotionWeights};

const STAGE: &str = "adapt";
/// Digits of the song's hash in its folder's name.
const DIGITS: usize = 16;

/// Songs to adapt to, the model to start from, and where the stage's files are.
pub struct Adaptation {
    /// Features and beats of each.
    songs: Vec<Song>,
    files: Vec<SongFile>,
    /// The model directory to start from; none starts from the run.
    model: Option<ServedModel>,
    /// `run.folder/adapted/<hash of the audio files and the model>`: the same files resume, under
    /// any names.
    pub folder: PathBuf,
}

/// An audio file, and the beginning of its hash.
struct SongFile {
    path: PathBuf,
    hash: String,
}

impl SongFile {
    fn open(path: PathBuf) -> Result<Self, TrainError> {
        let hash = File::open(&path).and_then(|mut file| file_sha256(&mut file));
        let hash = beginning(&hash.map_err(TrainError::file(&path))?);
        Ok(Self { path, hash })
    }
}

/// What is enough of a hash for a name.
fn beginning(hash: &str) -> String {
    hash.chars().take(DIGITS).collect()
}

impl Adaptation {
    /// Adapts `model`, else the run of `config`, to audio files and what their features are.
    ///
    /// # Errors
    /// [`TrainError::File`] if one cannot be read.
    pub fn new(
        config: &Config,
        songs: Vec<(PathBuf, Song)>,
        model: Option<ServedModel>,
    ) -> Result<Self, TrainError> {
        let (paths, songs): (Vec<_>, Vec<_>) = songs.into_iter().unzip();
        let files: Vec<_> = paths.into_iter().map(SongFile::open).collect::<Result<_, _>>()?;
        let hashes: Vec<&str> = files.iter().map(|file| file.hash.as_str()).collect();
        let mut place = match hashes[..] {
            [one] => one.to_owned(),
            _ => beginning(&sha256(hashes.join(" ").as_bytes())),
        };
        if let Some(model) = &model {
            place = format!("{place}-{}", beginning(model.sha256()));
        }
        let folder = config.run.folder.join("adapted").join(place);
        Ok(Self { songs, files, model, folder })
    }

    /// Returns the name of the song, or of each.
    fn names(&self) -> Value {
        let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into();
        match &self.files[..] {
            [one] => Value::String(name(&one.path)),
            all => all.iter().map(|song| Value::String(name(&song.path))).collect(),
        }
    }

    fn run(&self, config: &Config) -> RunConfig {
        RunConfig { folder: self.folder.clone(), ..config.run.clone() }
    }

    /// Imitates the model's own dances to the songs, the best of some candidates.
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
        let mut dances = Vec::with_capacity(self.files.len());
        for SongFile { path, hash } in &self.files {
            let place = (model, self.folder.as_path());
            dances.push(expert_dances(settings, place, (path, hash), seed, output)?);
        }
        let policy = match &dances[..] {
            // From any other code it would first have to find one of the dances.
            [one] => Policy {
                starts: one.starts(),
                style_starts: one.style_starts(&model.manifest().styles),
                ..model.policy()
            },
            // Several songs' dances have few starts for each style, which fit no other song.
            _ => model.policy(),
        };
        let (run, temperature) = (self.run(config), model.temperature());
        let songs = self.songs.iter().zip(dances).map(|(song, dances)| ImitatedSong {
            music: policy.conditioned(&song.rows, dances.style.as_deref()),
            dances: dances.codes,
        });
        let task = ImitationTask {
            name: STAGE,
            identity,
            run: &run,
            temperature: f64::from(temperature),
            songs: songs.collect(),
            policy,
        };
        on_device!(config.run.device.as_str(), |A, device| {
            imitate::<A>(config, task, &device, limits, output)
        })
    }

    /// Refuses a song that is too short, and other settings than an earlier adaptation had, before
    /// minutes are spent on dances.
    fn check(&self, config: &Config, identity: &Identity) -> Result<(), TrainError> {
        let least = config.gpt.block + 1;
        for (song, SongFile { path, .. }) in self.songs.iter().zip(&self.files) {
            let rows = song.rows.nrows();
            if rows < least {
                let message = format!("the song has {rows} rows of music, a window needs {least}");
                return Err(TrainError::Data { path: path.clone(), message });
            }
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
            songs: &self.songs,
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

/// Adapts a policy to songs: by imitating its own dances to them, the best of some candidates, or
/// by their rewards where there are no candidates or no model directory. `init` is an official
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
    let facts = [("adapted_to", adaptation.names())];
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
