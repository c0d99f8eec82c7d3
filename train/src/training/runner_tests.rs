//! The loop on a toy: a tensor that walks to 3 and passes 2, where its test loss is lowest.

use std::{fs, path::Path};

use burn_autodiff::Autodiff;
use burn_flex::{Flex, FlexDevice};
use burn_tensor::Tensor;

use super::{
    checkpoint::Checkpoint,
    config::{CheckpointPolicy, Config},
    error::TrainError,
    frozen::Halves,
    identity::{Identity, is_finished},
    kept::{checkpoint_path, kept_path},
    runner::{Limits, Outcome, run},
    stage::Stage,
    stop::StopFlag,
    trainable::{Losses, StageSpec, TrainableStage},
    velocity::Decoders,
};
use crate::nn::{Parameters, Store};

type Traced = Autodiff<Flex>;

const STEPS: u64 = 40;

#[derive(Clone, Copy, Default)]
struct Walk {
    /// Step with a finite loss whose derivative is NaN.
    spoiled: Option<u64>,
    no_test_split: bool,
    test_fails: bool,
}

impl TrainableStage<Traced> for Walk {
    const COLUMNS: &'static [&'static str] = &["loss"];
    const TEST_COLUMNS: &'static [&'static str] = &["test_loss", "test_place"];

    fn step(&mut self, parameters: &Parameters<Traced>, step: u64) -> Losses<Traced> {
        let place = parameters.tensors()[0].clone();
        let mut loss = (place.clone() - 3.0).square().mean();
        if self.spoiled == Some(step) {
            loss = loss + (place.clone() - place.detach()).sqrt().mean();
        }
        let metrics = vec![loss.clone().inner()];
        Losses { loss, metrics }
    }

    fn test(&self, parameters: &Parameters<Flex>) -> Option<Vec<f32>> {
        let place = mean(parameters.tensors()[0].clone());
        let loss = if self.test_fails { f32::NAN } else { (place - 2.0).abs() };
        (!self.no_test_split).then(|| vec![loss, place])
    }
}

fn mean(tensor: Tensor<Flex, 1>) -> f32 {
    tensor.mean().into_scalar()
}

fn config(folder: &Path) -> Config {
    let mut config = Config::parse(include_str!("../../presets/tiny.toml")).unwrap();
    config.run.folder = folder.to_owned();
    config.run.checkpoint_seconds = 0.0;
    config.run.log_steps = 5;
    config.run.test_steps = 7;
    config.vqvae.training.steps = STEPS;
    config.vqvae.training.rate = 0.15;
    config
}

/// Some weights.
fn first_store(config: &Config) -> Store {
    Decoders::new(config, &Halves::random(config)).store
}

/// Walks as the stage `vqvae` would train.
fn walk(config: &Config, walk: Walk, steps: Option<u64>) -> Result<Outcome, TrainError> {
    let limits = Limits { steps, ..Limits::default() };
    walk_to(config, walk, limits)
}

fn walk_to(config: &Config, mut walk: Walk, limits: Limits) -> Result<Outcome, TrainError> {
    let spec = StageSpec {
        name: "vqvae",
        run: &config.run,
        training: &config.vqvae.training,
        identity: Identity::without_data(config, Stage::VqVae)?,
        store: first_store(config),
        windows: 1,
    };
    run::<Traced, _>(&spec, &mut walk, &FlexDevice, limits, &mut Vec::new())
}

fn file(config: &Config, name: &str) -> Vec<u8> {
    fs::read(config.run.folder.join("vqvae").join(name)).unwrap()
}

/// The lines of `metrics.csv` as step, test loss and place.
fn tests(config: &Config) -> Vec<(u64, String, String)> {
    let text = String::from_utf8(file(config, "metrics.csv")).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("step,rate,loss,test_loss,test_place"));
    lines
        .map(|line| {
            let values: Vec<&str> = line.split(',').collect();
            let step = values[0].parse().unwrap();
            (step, values[3].to_owned(), values[4].to_owned())
        })
        .collect()
}

#[test]
fn a_second_process_in_the_folder_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let stage = folder.path().join("vqvae");
    fs::create_dir(&stage).unwrap();
    let other = fs::File::create(stage.join("lock")).unwrap();
    other.lock().unwrap();
    let refused = walk(&config, Walk::default(), None).unwrap_err();
    assert!(matches!(&refused, TrainError::Busy { folder } if *folder == stage), "{refused}");
    assert!(!checkpoint_path(&config.run, "vqvae").exists());
    drop(other);
    assert_eq!(walk(&config, Walk::default(), None).unwrap(), Outcome::Finished);
}

#[test]
fn tests_have_lines_and_the_best_weights_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    walk(&config, Walk::default(), None).unwrap();
    let lines = tests(&config);
    let steps: Vec<u64> = lines.iter().map(|line| line.0).collect();
    assert_eq!(steps, [5, 7, 10, 14, 15, 20, 21, 25, 28, 30, 35, 40]);
    let measured = lines.iter().filter(|(_, loss, _)| !loss.is_empty());
    let measured: Vec<(f32, u64)> =
        measured.map(|(step, loss, _)| (loss.parse().unwrap(), *step)).collect();
    let steps: Vec<u64> = measured.iter().map(|&(_, step)| step).collect();
    assert_eq!(steps, [7, 14, 21, 28, 35, 40]);

    let best = measured.iter().copied().reduce(|a, b| if b.0 < a.0 { b } else { a });
    let (value, step) = best.unwrap();
    assert!(step < STEPS && value < measured[5].0, "{measured:?}");
    let path = |name| folder.path().join("vqvae").join(name);
    let checkpoint = Checkpoint::read(&path("best.safetensors")).unwrap().unwrap();
    let store = first_store(&config);
    let (name, _) = &store.entries()[0];
    let kept = checkpoint.tensor(&format!("weight.{name}")).unwrap().data();
    let place = kept.iter().sum::<f32>() / kept.len() as f32;
    assert!(((place - 2.0).abs() - value).abs() < 1e-5);
    let last = Checkpoint::read(&path("checkpoint.safetensors")).unwrap().unwrap();
    for checkpoint in [checkpoint, last] {
        assert_eq!(checkpoint.fact("best_step"), step.to_string());
        assert_eq!(checkpoint.fact("best"), value.to_string());
    }
}

#[test]
fn a_broken_run_ends_as_an_undisturbed_one() {
    let folders = [0, 1].map(|_| tempfile::tempdir().unwrap());
    let [whole, broken] = [0, 1].map(|index| config(folders[index].path()));
    walk(&whole, Walk::default(), None).unwrap();
    assert_eq!(walk(&broken, Walk::default(), Some(13)).unwrap(), Outcome::Paused);
    let checkpoint = file(&broken, "checkpoint.safetensors");
    assert_eq!(walk(&broken, Walk::default(), Some(25)).unwrap(), Outcome::Paused);
    // As if killed between checkpoints: lines and best weights are ahead of the checkpoint.
    fs::write(checkpoint_path(&broken.run, "vqvae"), checkpoint).unwrap();
    fs::write(broken.run.folder.join("vqvae/best.partial"), b"half").unwrap();
    assert_eq!(walk(&broken, Walk::default(), None).unwrap(), Outcome::Finished);
    for name in ["metrics.csv", "checkpoint.safetensors", "best.safetensors", "loss.svg"] {
        assert!(file(&whole, name) == file(&broken, name), "{name} differs");
    }
    assert!(!broken.run.folder.join("vqvae/best.partial").exists());
}

#[test]
fn a_finished_stage_can_be_lengthened_but_not_shortened() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    let finished = |config: &Config| is_finished(config, Stage::VqVae);
    walk(&config, Walk::default(), None).unwrap();
    assert!(finished(&config).unwrap());
    config.vqvae.training.steps = STEPS + 10;
    assert!(!finished(&config).unwrap());
    assert_eq!(walk(&config, Walk::default(), None).unwrap(), Outcome::Finished);
    assert!(finished(&config).unwrap());
    let steps: Vec<u64> = tests(&config).iter().map(|line| line.0).collect();
    assert_eq!(steps[..2], [5, 7]);
    assert_eq!(steps[steps.len() - 2..], [49, 50]);
    config.vqvae.training.steps = STEPS;
    for refused in
        [finished(&config).unwrap_err(), walk(&config, Walk::default(), None).unwrap_err()]
    {
        let message = refused.to_string();
        assert!(message.contains("has done 50 steps, more than the 40"), "{message}");
    }
}

#[test]
fn a_raised_flag_stops_with_a_checkpoint() {
    static STOP: StopFlag = StopFlag::new();
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    config.run.checkpoint_seconds = 1e9;
    STOP.request();
    let limits = Limits { stop: Some(&STOP), ..Limits::default() };
    let outcome = walk_to(&config, Walk::default(), limits);
    assert_eq!(outcome.unwrap(), Outcome::Paused);
    let checkpoint = Checkpoint::read(&checkpoint_path(&config.run, "vqvae"));
    assert_eq!(checkpoint.unwrap().unwrap().fact("step"), "1");
}

#[test]
fn values_that_are_no_numbers_stop_the_run_and_are_not_kept() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let step = || {
        let checkpoint = Checkpoint::read(&checkpoint_path(&config.run, "vqvae"));
        checkpoint.unwrap().unwrap().fact("step").to_owned()
    };
    let spoiled = Walk { spoiled: Some(11), ..Walk::default() };
    let error = walk(&config, spoiled, None).unwrap_err();
    assert!(matches!(error, TrainError::NotFinite { step: 12, .. }), "{error}");
    assert_eq!(step(), "11");
    let best = file(&config, "best.safetensors");
    let failing = Walk { test_fails: true, ..Walk::default() };
    let error = walk(&config, failing, None).unwrap_err();
    assert!(
        matches!(error, TrainError::NotFinite { step: 14, column: "test_loss", .. }),
        "{error}"
    );
    assert_eq!(step(), "13");
    assert_eq!(file(&config, "best.safetensors"), best);
}

#[test]
fn the_weights_asked_for_are_used() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    let identity = |config: &Config, stage| Identity::without_data(config, stage).unwrap();
    let last = identity(&config, Stage::VqVae);
    let name = |config: &Config| {
        let path = kept_path(config, Stage::VqVae);
        path.map(|path| path.file_name().unwrap().to_owned())
    };
    walk(&config, Walk::default(), Some(20)).unwrap();
    assert!(matches!(name(&config), Err(TrainError::StageMissing { stage: "vqvae", .. })));
    assert!(!is_finished(&config, Stage::VqVae).unwrap());
    walk(&config, Walk::default(), None).unwrap();
    assert!(is_finished(&config, Stage::VqVae).unwrap());
    assert_eq!(name(&config).unwrap(), "checkpoint.safetensors");
    let on_last = identity(&config, Stage::Gpt);
    config.vqvae.checkpoint_policy = CheckpointPolicy::Best;
    assert_eq!(name(&config).unwrap(), "best.safetensors");
    // The stage itself is as it was; what is built on it is not.
    assert_eq!(identity(&config, Stage::VqVae), last);
    assert_ne!(identity(&config, Stage::Gpt), on_last);
    config.vqvae.codes += 1;
    assert!(matches!(is_finished(&config, Stage::VqVae), Err(TrainError::State { .. })));
}

#[test]
fn without_a_test_split_the_last_weights_are_used() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    config.vqvae.checkpoint_policy = CheckpointPolicy::Best;
    let walked = Walk { no_test_split: true, ..Walk::default() };
    walk(&config, walked, None).unwrap();
    assert!(tests(&config).iter().all(|(_, loss, place)| loss.is_empty() && place.is_empty()));
    let path = kept_path(&config, Stage::VqVae).unwrap();
    assert_eq!(path, checkpoint_path(&config.run, "vqvae"));
}
