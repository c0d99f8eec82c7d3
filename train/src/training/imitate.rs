//! Expert iteration (Anthony et al. 2017): the policy imitates dances that it made with a choice
//! among candidates. State network and VQ-VAE are frozen, as with rewards.

use std::io::Write;

use burn_tensor::Tensor;
use ndarray::Array2;

use super::{
    checkpoint::Checkpoint,
    config::{AdaptConfig, Config, RunConfig},
    error::TrainError,
    identity::Identity,
    policy::Policy,
    rollout::shuffled,
    runner::{Limits, Outcome, run},
    sampling::Window,
    trainable::{Losses, StageSpec, TrainableStage},
    trajectory_batch::TrajectoryBatch,
    windows::generator,
};
use crate::nn::{Parameters, Trainable};

/// A generator's seed.
const ORDER: u64 = 0x696d_6974;

/// What is imitated.
pub(super) struct ImitationTask<'a> {
    pub(super) name: &'static str,
    /// Everything that the result depends on.
    pub(super) identity: Identity,
    pub(super) run: &'a RunConfig,
    /// The policy that learns.
    pub(super) policy: Policy,
    /// Temperature that it is served at.
    pub(super) temperature: f64,
    pub(super) songs: Vec<ImitatedSong>,
}

/// Dances to a song.
pub(super) struct ImitatedSong {
    /// Scaled rows of the song; row `k + 1` is beside code `k`.
    pub(super) music: Array2<f32>,
    /// Upper and lower codes of each dance.
    pub(super) dances: Vec<[Vec<i32>; 2]>,
}

/// A window's song, dance to it, and first code.
type Place = (usize, usize, usize);

struct ImitationStage<'a, A: Trainable> {
    settings: &'a AdaptConfig,
    base_layers: usize,
    task: ImitationTask<'a>,
    /// The policy as the stage found it.
    reference: Parameters<A::InnerBackend>,
    windows: Vec<Place>,
    /// The epoch that the order is of, and the order.
    order: Option<(usize, Vec<usize>)>,
    device: A::Device,
}

/// Runs the stage.
pub(super) fn imitate<A: Trainable>(
    config: &Config,
    task: ImitationTask<'_>,
    device: &A::Device,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    let settings = &config.adapt;
    let block = task.policy.net.block();
    let windows = windows(&task.songs, block, settings.stride);
    if windows.is_empty() {
        return Err(TrainError::TooShort { length: block + 1, unit: "rows of music" });
    }
    let spec = StageSpec {
        name: task.name,
        run: task.run,
        training: &settings.training,
        identity: task.identity.clone(),
        store: task.policy.store.clone(),
        windows: windows.len(),
    };
    let mut stage = ImitationStage::<A> {
        settings,
        base_layers: config.gpt.base_layers,
        reference: Parameters::from_store(&spec.store, device),
        task,
        windows,
        order: None,
        device: device.clone(),
    };
    run(&spec, &mut stage, device, limits, output)
}

/// Returns the windows of `block` codes of all dances that have music.
fn windows(songs: &[ImitatedSong], block: usize, stride: usize) -> Vec<Place> {
    let windows = songs.iter().enumerate().flat_map(|(song, ImitatedSong { music, dances })| {
        dances.iter().enumerate().flat_map(move |(dance, [upper, _])| {
            let codes = upper.len().min(music.nrows().saturating_sub(1));
            let starts = (codes + 1).saturating_sub(block);
            (0..starts).step_by(stride).map(move |first| (song, dance, first))
        })
    });
    windows.collect()
}

impl<A: Trainable> ImitationStage<'_, A> {
    /// Returns the windows of a step: in every epoch each once, in another order.
    fn batch(&mut self, step: u64) -> Vec<Place> {
        let (size, count) = (self.settings.training.batch, self.windows.len());
        let first = step as usize * size;
        let places = (first..first + size).map(|place| {
            let (epoch, place) = (place / count, place % count);
            let order = match self.order.take() {
                Some((known, order)) if known == epoch => order,
                _ => {
                    let mut random = generator(ORDER, epoch as u64);
                    shuffled((0..count).collect(), &mut random)
                }
            };
            let window = self.windows[order[place]];
            self.order = Some((epoch, order));
            window
        });
        places.collect()
    }
}

impl<A: Trainable> TrainableStage<A> for ImitationStage<'_, A> {
    const COLUMNS: &'static [&'static str] = &["loss", "imitation", "entropy", "divergence"];

    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A> {
        let windows = self.batch(step);
        let task = &self.task;
        let windows = windows.iter().map(|&(song, dance, first)| {
            let ImitatedSong { music, dances } = &task.songs[song];
            Window { music: music.view(), codes: &dances[dance], first }
        });
        let net = &task.policy.net;
        let windows: Vec<Window<'_>> = windows.collect();
        let batch = TrajectoryBatch::<A>::imitated(&windows, net.block(), &self.device);
        let base_layers = self.base_layers;
        // The state network is frozen and runs without dropout: it never sees `parameters`.
        let frozen = parameters.untracked();
        let states =
            net.states(&frozen, batch.music.clone(), batch.states.clone(), base_layers, 0.0);
        let reference = net.policy(&self.reference, states.clone(), base_layers, 0.0);
        let states = Tensor::<A, 3>::from_inner(states);
        let logits = net.policy(parameters, states, base_layers, 0.0);
        // What is imitated was drawn at this temperature: at 1 every pass would make the policy
        // more certain.
        let logits = logits.at_temperature(task.temperature);
        let reference = reference.at_temperature(task.temperature);
        let divergence = batch.mean(batch.divergence(logits.clone(), reference));
        let (cross_entropy, entropy) = batch.policy(logits);
        let (imitation, entropy) = (batch.mean(cross_entropy), batch.mean(entropy));
        let weight = self.settings.divergence_weight;
        let loss = imitation.clone() + divergence.clone().mul_scalar(weight);
        let metrics = [&loss, &imitation, &entropy, &divergence];
        Losses { metrics: metrics.map(|metric| metric.clone().inner()).into(), loss }
    }

    fn save(&self, checkpoint: &mut Checkpoint) {
        self.task.policy.save(checkpoint);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use burn_autodiff::Autodiff;
    use burn_flex::{Flex, FlexDevice};

    use super::*;
    use crate::{
        nn::{GptNet, Store},
        training::{
            manners::Manners, metrics::read_series, music_scale::MusicScale, policy::random,
        },
    };

    #[test]
    fn a_policy_learns_the_dances_of_its_songs() {
        const COLUMNS: usize = 3;
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::parse(include_str!("../../presets/tiny.toml")).unwrap();
        config.run.folder = folder.path().to_owned();
        config.run.log_steps = 1;
        config.gpt.block = 8;
        (config.adapt.stride, config.adapt.divergence_weight) = (3, 0.01);
        let training = &mut config.adapt.training;
        (training.batch, training.epochs, training.rate) = (6, 40, 3e-3);
        let mut store = Store::default();
        let policy = Policy {
            net: GptNet::new(&random(&config, COLUMNS), &mut store),
            store,
            scale: MusicScale::plain(COLUMNS),
            manners: Manners::default(),
            starts: vec![[3, 5]],
            style_starts: BTreeMap::new(),
            style_codes: BTreeMap::new(),
            critic: None,
        };
        let dance =
            |step: i32| [step, 2 * step].map(|step| (0..19).map(|k| k * step % 7).collect());
        let song = |tempo: f32, step| ImitatedSong {
            music: Array2::from_shape_fn((20, COLUMNS), |(row, column)| {
                (row as f32 * (tempo + column as f32)).sin()
            }),
            dances: vec![dance(step)],
        };
        let task = ImitationTask {
            name: "adapt",
            identity: Identity::default(),
            run: &config.run,
            policy,
            temperature: 0.5,
            songs: vec![song(0.5, 1), song(0.8, 3)],
        };
        // 19 codes have 12 windows of 8, of which every third is used.
        let places: Vec<_> = windows(&task.songs, 8, 3);
        assert_eq!(places[..5], [(0, 0, 0), (0, 0, 3), (0, 0, 6), (0, 0, 9), (1, 0, 0)]);
        let log = &mut Vec::new();
        imitate::<Autodiff<Flex>>(&config, task, &FlexDevice, Limits::default(), log).unwrap();
        let series = read_series(&folder.path().join("adapt/metrics.csv")).unwrap();
        let ends = |name: &str| (series[name][0].1, series[name].last().unwrap().1);
        let (first, last) = ends("imitation");
        assert!(first > 2.0 && last < 0.5 * first, "{first} {last}");
        let (first, last) = ends("divergence");
        assert!(first.abs() < 1e-5 && last > 0.1, "{first} {last}");
    }
}
