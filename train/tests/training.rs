//! All stages with the `tiny` preset on made-up motion: losses fall, a resumed run equals an
//! undisturbed one, and the served model equals the trainer's networks.

use std::{fs, path::Path, sync::Arc};

use crate::common::{self, swinging};
use bailando::model::{ModelDirectory, Steps, code_pairs};
use bailando_train::{
    nn::{Codebook, DecoderNet, GptNet, Parameters, Store},
    training::{
        Config, Limits, MotionFrame, MotionPiece, MotionSet, Motions, Outcome, SongRows, Stage,
        export, train, trained_weights,
    },
};
use burn_flex::{Flex, FlexDevice};
use burn_tensor::{Int, Tensor, TensorData};
use ndarray::Array2;

const STAGES: [Stage; 3] = [Stage::VqVae, Stage::Velocity, Stage::Gpt];
const TOLERANCE: f32 = 1e-4;

fn config(folder: &Path) -> Config {
    let mut config = Config::parse(include_str!("../presets/tiny.toml")).unwrap();
    config.run.folder = folder.join("run");
    config.export.folder = folder.join("model");
    config
}

/// Joints that swing at different rates while the root walks; music that follows the same clock.
fn motion_set() -> MotionSet {
    let piece = |phase: f32| {
        let positions = swinging(phase);
        let music = |start: usize| {
            let start = phase + start as f32 / 60.0;
            Arc::new(Array2::from_shape_fn((60, 438), |(row, column)| {
                (row as f32 / 7.5 + start + column as f32).cos() * (1.0 + column as f32 / 50.0)
            }))
        };
        let song = SongRows::new([0, 1].map(music).into()).unwrap();
        let piece = MotionPiece::from_positions(positions, MotionFrame::Dancer).unwrap();
        piece.with_song(song)
    };
    MotionSet::new(Motions::new([0.0, 0.7, 1.9].map(piece).into()), None)
}

fn run(config: &Config, set: &MotionSet, stage: Stage, limits: Limits) -> Outcome {
    train(stage, config, set, None, limits, &mut Vec::new()).unwrap()
}

fn losses(config: &Config, stage: &str) -> Vec<f32> {
    let text = fs::read_to_string(config.run.folder.join(stage).join("metrics.csv")).unwrap();
    let lines = text.lines().skip(1);
    lines.map(|line| line.split(',').nth(2).unwrap().parse().unwrap()).collect()
}

#[test]
fn a_run_learns_resumes_exactly_and_is_served() {
    let _alone = common::alone();
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let [whole, broken] = [0, 1].map(|index| config(folders[index].path()));
    let set = motion_set();
    for stage in STAGES {
        assert_eq!(run(&whole, &set, stage, Limits::default()), Outcome::Finished);
        for steps in [7, 18] {
            let limits = Limits { steps: Some(steps), ..Limits::default() };
            assert_eq!(run(&broken, &set, stage, limits), Outcome::Paused);
        }
        assert_eq!(run(&broken, &set, stage, Limits::default()), Outcome::Finished);
    }
    for stage in ["vqvae", "velocity", "gpt"] {
        let losses = losses(&whole, stage);
        let (first, last) = (losses[0], losses[losses.len() - 1]);
        println!("{stage}: {first} to {last}");
        assert!(last < 0.9 * first, "{stage}: {losses:?}");
        for file in ["metrics.csv", "checkpoint.safetensors"] {
            let read =
                |config: &Config| fs::read(config.run.folder.join(stage).join(file)).unwrap();
            assert!(read(&whole) == read(&broken), "{stage}/{file} differs after resuming");
        }
    }
    export(&whole, false).unwrap();
    serves_the_same(&whole);
}

fn serves_the_same(config: &Config) {
    let (vqvae, gpt, starts) = trained_weights(config).unwrap();
    assert!(!starts.is_empty());
    let directory = ModelDirectory::open(&config.export.folder).unwrap();
    assert_eq!(directory.manifest().start_codes, starts);
    let codes = |seed: usize| -> Vec<u32> { (0..20).map(|k| (k * seed % 16) as u32).collect() };
    let (upper, lower) = (codes(5), codes(3));
    let device = FlexDevice;
    let indices = |codes: &[u32]| {
        let codes: Vec<i32> = codes.iter().map(|&code| code as i32).collect();
        let shape = [codes.len()];
        Tensor::<Flex, 1, Int>::from_data(TensorData::new(codes, shape), &device)
    };

    let mut store = Store::default();
    let net = DecoderNet::new("root", &vqvae.root, &mut store);
    let entries = Codebook::<Flex>::new(&vqvae.lower.codebook, &device).lookup(indices(&lower));
    let parameters = Parameters::from_store(&store, &device);
    let velocity = net.forward(&parameters, entries.unsqueeze_dim(0)).into_data();
    let velocity: Vec<f32> = velocity.iter::<f32>().collect();
    let mut decoder = directory.decoder(1).unwrap();
    let pairs = code_pairs(&upper, &lower).unwrap();
    let served = decoder.decode(&pairs).unwrap();
    assert_eq!(served.nrows() * 4, velocity.len());
    for (frame, wanted) in velocity.chunks(4).enumerate() {
        // The turn follows all joints.
        for (column, wanted) in [0, 1, 2, 72].into_iter().zip(wanted) {
            assert!((served[[frame, column]] - wanted).abs() <= TOLERANCE);
        }
    }

    let mut store = Store::default();
    let net = GptNet::new(&gpt, &mut store);
    let parameters = Parameters::from_store(&store, &device);
    let music = Array2::from_shape_fn((20, 438), |(row, column)| ((row + column) as f32).sin());
    let rows = TensorData::new(music.iter().copied().collect::<Vec<f32>>(), [1, 20, 438]);
    let halves = [&upper, &lower].map(|codes| indices(codes).unsqueeze_dim::<2>(0));
    let logits = net.forward(&parameters, Tensor::from_data(rows, &device), halves, 0.0);
    let mut served = directory.gpt(1).unwrap();
    let steps = Steps { codes: &pairs, music: music.view() };
    let served = served.logits(steps).unwrap();
    for (own, served) in [(logits.upper, served.upper), (logits.lower, served.lower)] {
        let own: Vec<f32> = own.into_data().iter::<f32>().collect();
        assert_eq!(own.len(), served.len());
        for (own, served) in own.iter().zip(&served) {
            assert!((own - served).abs() <= TOLERANCE, "{own} {served}");
        }
    }
}
