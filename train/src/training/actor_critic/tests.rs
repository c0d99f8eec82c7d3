use std::{collections::BTreeMap, path::Path};

use burn_autodiff::Autodiff;
use burn_flex::{Flex, FlexDevice};
use ndarray::Array2;

use super::*;
use crate::{
    nn::{GptNet, VqVaeSizes, random_vqvae},
    training::{manners::Manners, music_scale::MusicScale, policy::random},
    weights::VqVaeWeights,
};

const COLUMNS: usize = 3;

#[test]
fn turns_follow_each_other() {
    let mut stage = Config::parse("").unwrap().actor_critic;
    (stage.critic_warmup_steps, stage.actor_steps, stage.critic_steps) = (1, 2, 3);
    for (step, wanted) in "CAACCCAACCCAA".chars().enumerate() {
        let wanted = match wanted {
            'A' => Turn::Actor,
            _ => Turn::Critic,
        };
        assert_eq!(stage.turn(step as u64), wanted, "{step}");
    }
    stage.critic_steps = 0;
    assert_eq!([0, 1, 3].map(|step| stage.turn(step)), [Turn::Critic, Turn::Both, Turn::Both]);
}

/// A policy that knows nothing, with small windows.
fn toy(folder: &Path) -> (Config, Policy, Vec<Song>) {
    let mut config = Config::parse(include_str!("../../../presets/tiny.toml")).unwrap();
    config.run.folder = folder.to_owned();
    config.run.log_steps = 1;
    config.gpt.block = 8;
    let stage = &mut config.actor_critic;
    (stage.pieces_per_epoch, stage.codes) = (8, 16);
    (stage.training.batch, stage.training.epochs, stage.training.rate) = (24, 20, 3e-3);
    let mut store = Store::default();
    let policy = Policy {
        net: GptNet::new(&random(&config, COLUMNS), &mut store),
        store,
        scale: MusicScale { mean: vec![0.0; COLUMNS], spread: vec![1.0; COLUMNS] },
        manners: Manners::default(),
        starts: vec![[3, 5], [9, 1]],
        style_starts: BTreeMap::new(),
        style_codes: BTreeMap::new(),
        critic: None,
    };
    let song = |phase: f32| Song {
        rows: Array2::from_shape_fn((30, COLUMNS), |(row, column)| {
            (row as f32 * (0.5 + column as f32) + phase).sin()
        }),
        beats: Vec::new(),
        style: None,
    };
    (config, policy, [0.0, 1.0].map(song).into())
}

/// Decoders for rewards that do not look at motion.
fn never_decoded() -> MotionWeights {
    let sizes =
        VqVaeSizes { half_columns: [3, 3], width: 2, embedding: 2, codes: 2, root_columns: 3 };
    let VqVaeWeights { upper, lower, .. } = random_vqvae(sizes, 1);
    MotionWeights {
        codebooks: [upper.codebook, lower.codebook],
        halves: [upper.decoder, lower.decoder],
        root: None,
    }
}

/// Trains the toy policy.
fn learned(
    config: &Config,
    policy: Policy,
    songs: &[Song],
    rewards: RewardFn,
    limits: Limits,
) -> Store {
    let task = RewardTask {
        name: "actor-critic",
        identity: Identity::default(),
        run: &config.run,
        stage: &config.actor_critic,
        policy,
        motion: never_decoded(),
        init: None,
        songs,
    };
    let stage = ActorCriticStage::<Autodiff<Flex>>::new(config, task, rewards, &FlexDevice);
    let (spec, mut stage) = stage.unwrap();
    run(&spec, &mut stage, &FlexDevice, limits, &mut Vec::new()).unwrap();
    spec.store
}

/// Rewards every fourth upper code.
fn fourths() -> RewardFn {
    let quarter = |code: i32| if code % 4 == 0 { 1.0 } else { -1.0 };
    Box::new(move |pieces, _| {
        let rewards =
            |[upper, _]: &[Vec<i32>; 2]| upper.iter().map(|&code| [quarter(code); 3]).collect();
        pieces.iter().map(rewards).collect()
    })
}

#[test]
fn actor_and_critic_count_their_own_steps() {
    let folder = tempfile::tempdir().unwrap();
    let (mut config, policy, songs) = toy(folder.path());
    config.actor_critic.critic_steps = 0;
    config.actor_critic.critic_warmup_steps = 2;
    let limits = Limits { steps: Some(5), ..Limits::default() };
    let store = learned(&config, policy, &songs, fourths(), limits);
    let path = folder.path().join("actor-critic/checkpoint.safetensors");
    let checkpoint = Checkpoint::read(&path).unwrap().unwrap();
    let updates = checkpoint.tensor("adam.updates").unwrap().data().iter();
    for ((name, _), &updates) in store.entries().iter().zip(updates) {
        match name.starts_with("critic") {
            true => assert_eq!(updates, 5.0, "{name}: its warm-up counts"),
            false => assert!([0.0, 3.0].contains(&updates), "{name}: {updates}"),
        }
    }
}

#[test]
fn an_official_critic_must_be_of_the_configured_size() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/model");
    let path = Path::new(folder).join("tiny_gpt.pt");
    let mut config = Config::parse("").unwrap();
    (config.gpt.channels, config.gpt.heads) = (48, 4);
    config.actor_critic.critic_layers = 1;
    let critic = official_critic(&config, &path).unwrap();
    assert_ne!(critic, first_critic(&config));
    config.actor_critic.critic_layers = 2;
    let refused = official_critic(&config, &path).unwrap_err();
    assert!(matches!(refused, TrainError::State { .. }), "{refused}");
}

#[test]
fn the_policy_gets_better_at_what_is_rewarded() {
    let folder = tempfile::tempdir().unwrap();
    let (config, policy, songs) = toy(folder.path());
    learned(&config, policy, &songs, fourths(), Limits::default());
    let path = folder.path().join("actor-critic/metrics.csv");
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().skip(1);
    let rewards = lines.map(|line| line.split(',').nth(6).unwrap().parse::<f32>().unwrap());
    let rewards: Vec<f32> = rewards.collect();
    let (first, last) = (rewards[0], rewards[rewards.len() - 1]);
    assert!(first < 0.0 && last > first + 0.5, "{first} {last}");
}
