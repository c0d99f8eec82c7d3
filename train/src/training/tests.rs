//! What the stages take from their data, and how test losses compare with those of training.

use std::{path::Path, sync::Arc};

use bailando::motion::Positions;
use burn_autodiff::Autodiff;
use burn_flex::{Flex, FlexDevice};
use ndarray::{Array2, Axis, Slice};

use super::{
    checkpoint::Checkpoint,
    codes::{Augmentation, Codes},
    condition::Condition,
    crops::motion_columns,
    decode::MotionDecoder,
    frozen::FrozenVqVae,
    generate::{TestPiece, codes as generated_codes, motions},
    gpt::GptStage,
    metrics::read_series,
    policy::Policy,
    trainable::TrainableStage,
    velocity::{Decoders, VelocityStage},
    vqvae::VqVaeStage,
    *,
};
use crate::{
    data::{Draw, Evaluation, FRAMES_PER_CODE, Motion, SplitKind, mirrored, testing},
    export::skeleton,
    nn::{Parameters, Store, numbers, values},
};

type Tracked = Autodiff<Flex>;

pub(super) const FRAMES: usize = 301;

pub(super) fn config(folder: &Path) -> Config {
    let mut config = Config::parse(include_str!("../../presets/tiny.toml")).unwrap();
    config.run.folder = folder.to_owned();
    config.vqvae.training.steps = 3;
    config.gpt.dropout = 0.0;
    config.gpt.standardise_music = false;
    config
}

/// A swaying figure, and songs whose rows say which frame they lie at.
fn piece(positions: Positions, songs: usize, phases: usize) -> MotionPiece {
    let frames = positions.len_of(Axis(0));
    let piece = MotionPiece::from_positions(positions, MotionFrame::Dancer).unwrap();
    let rows = |phase: usize| {
        let count = 1 + (frames - phase) / FRAMES_PER_CODE;
        let row = |(row, _)| (phase + FRAMES_PER_CODE * row) as f32;
        Arc::new(Array2::from_shape_fn((count, 3), row))
    };
    let song = || SongRows::new((0..phases).map(rows).collect()).unwrap();
    (0..songs).fold(piece, |piece, _| piece.with_song(song()))
}

fn dance(frames: usize, seed: u32) -> Positions {
    testing::dance(&skeleton(0.93), frames, seed)
}

pub(super) fn whole<S: SplitKind>(frames: usize) -> Motions<S> {
    Motions::new(vec![piece(dance(frames, 3), 1, 1)])
}

fn part(positions: &Positions, from: usize) -> Positions {
    let frames = Slice::from(from..);
    positions.slice_axis(Axis(0), frames).to_owned()
}

fn codes<B: crate::nn::Kernels<Device = FlexDevice>>(
    frozen: &FrozenVqVae<B>,
    piece: &MotionPiece,
) -> [Vec<i32>; 2] {
    let frames = piece.frames() / FRAMES_PER_CODE * FRAMES_PER_CODE;
    let whole = Draw { ..Draw::default() };
    let piece = std::slice::from_ref(piece);
    [0, 1].map(|half| {
        let motion =
            motion_columns(piece, &[whole], frames, &frozen.halves.columns[half], &FlexDevice);
        let net = &frozen.halves.nets[half];
        let codes = net.encode(&frozen.parameters, &frozen.codebooks[half], motion);
        codes.into_data().iter::<i32>().collect()
    })
}

#[test]
fn codes_and_rows_of_every_phase_and_side_lie_at_the_same_frames() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    config.data.phases = 8;
    let positions = [dance(FRAMES, 1), dance(250, 2)];
    let pieces = [(&positions[0], 2), (&positions[1], 1)];
    let pieces = pieces.map(|(positions, songs)| piece(positions.clone(), songs, 8));
    let set = MotionSet::new(Motions::new(pieces.into()), None);
    let log = &mut Vec::new();
    train(Stage::VqVae, &config, &set, None, Limits::default(), log).unwrap();

    let frozen = FrozenVqVae::<Flex>::read(&config, &FlexDevice).unwrap();
    let wanted = Augmentation { mirror: true, phases: 8, vectors: true };
    let found = Codes::encode(&frozen, set.training.pieces(), wanted, &FlexDevice, log);
    for (index, positions) in positions.iter().enumerate() {
        for phase in 0..8 {
            for side in [false, true] {
                let motion = Motion::new(part(positions, phase));
                let motion = if side { mirrored(&motion) } else { motion };
                let expected = codes(&frozen, &piece(motion.into_positions(), 0, 0));
                let draw = Draw { dance: index, phase, mirrored: side, ..Draw::default() };
                assert_eq!(found.of(&draw), &expected, "{draw:?}");
                for half in [0, 1] {
                    let vectors = found.vectors_of(&draw)[half].clone();
                    let codes = expected[half].len();
                    assert_eq!(vectors.len(), codes * config.vqvae.embedding);
                    let shape = [codes, config.vqvae.embedding];
                    let vectors = numbers::<Flex, 2>(vectors, shape, &FlexDevice);
                    let nearest = frozen.codebooks[half].nearest(vectors);
                    let nearest: Vec<i32> = nearest.into_data().iter::<i32>().collect();
                    assert_eq!(nearest, expected[half], "{draw:?}");
                }
            }
        }
    }
    assert_eq!(found.starts(&[0, 0]).count(), 4);

    let (spec, stage) = GptStage::<Tracked>::new(&config, &set, None, &FlexDevice, log).unwrap();
    assert_eq!(spec.windows, (37 - 29) + (31 - 29));
    let block = config.gpt.block;
    let crops = crate::data::CropPlan { frames: 8 * (block + 1), stride: 8, mirror: true };
    for draw in crops.round(&set.training.music_choices(8), 5, 0) {
        let rows = values(&stage.music::<Flex>(set.training.pieces(), &[Condition::own(&draw)]));
        for (row, values) in rows.chunks(3).enumerate() {
            // Row k + 1 beside code k, which begins at frame 8 k of the dance without its phase.
            let frame = draw.phase + draw.start + 8 * (row + 1);
            assert_eq!(values[0], frame as f32);
        }
    }
}

/// Training has one window alone, and the test split the same dance: the losses must be equal.
#[test]
fn test_losses_are_the_losses_without_learning() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    (config.data.mirror, config.data.phases) = (false, 1);
    for training in
        [&mut config.vqvae.training, &mut config.velocity.training, &mut config.gpt.training]
    {
        training.batch = 1;
    }
    (config.vqvae.frames, config.velocity.frames) = (240, 240);
    config.vqvae.contact_weight = 3.0;
    let set = MotionSet::new(whole(240), Some(whole::<Evaluation>(240)));
    let log = &mut Vec::new();

    let (spec, mut stage) = VqVaeStage::<Tracked>::new(&config, &set, None, &FlexDevice).unwrap();
    let parameters = Parameters::<Flex>::from_store(&spec.store, &FlexDevice);
    assert_eq!(stage.test(&parameters), None, "no codes yet");
    stage.step(&parameters.tracked(), 0);
    compare(&mut stage, &parameters, &[0, 2, 9]);

    train(Stage::VqVae, &config, &set, None, Limits::default(), log).unwrap();
    config.velocity.pose_decoders = true;
    config.velocity.speed_weight = 2.0;
    config.velocity.contact_weight = 3.0;
    config.velocity.energy_weight = 3.0;
    let (spec, mut stage) =
        VelocityStage::<Tracked>::new(&config, &set, None, &FlexDevice).unwrap();
    let parameters = Parameters::from_store(&spec.store, &FlexDevice);
    compare(&mut stage, &parameters, &[0, 3]);
    let output = spec.store.entries().iter().find(|(name, _)| name == "root.output.bias");
    assert_eq!(output.unwrap().1.shape(), [4]);

    let (spec, mut stage) =
        GptStage::<Tracked>::new(&config, &set, None, &FlexDevice, log).unwrap();
    let parameters = Parameters::from_store(&spec.store, &FlexDevice);
    compare(&mut stage, &parameters, &[0, 1, 2]);
}

#[test]
fn standing_at_either_end_is_not_learned() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    let mut positions = dance(600, 1);
    for (still, frames) in [(40, 0..40), (559, 560..600)] {
        let pose = positions.index_axis(Axis(0), still).to_owned();
        for frame in frames {
            positions.index_axis_mut(Axis(0), frame).assign(&pose);
        }
    }
    let dancing = piece(positions.clone(), 1, 1);
    assert_eq!(dancing.dancing(), 40..559);
    let set = MotionSet::new(Motions::new(vec![dancing]), None);
    let log = &mut Vec::new();
    train(Stage::VqVae, &config, &set, None, Limits::default(), log).unwrap();
    let mut windows = |trim_still: bool| {
        config.gpt.trim_still = trim_still;
        let (spec, stage) =
            GptStage::<Tracked>::new(&config, &set, None, &FlexDevice, log).unwrap();
        let mut checkpoint = Checkpoint::default();
        stage.save(&mut checkpoint);
        let starts = checkpoint.tensor("start_codes").unwrap().shape().to_vec();
        assert_eq!(starts[1], 2);
        spec.windows
    };
    // Of 75 codes with their rows, or of those from the fifth on that end before frame 559.
    assert_eq!([false, true].map(&mut windows), [75 - 29, 69 - 5 - 29]);
}

#[test]
fn decoders_of_both_halves_learn_on_where_asked_to() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    config.velocity.pose_decoders = true;
    config.velocity.speed_weight = 2.0;
    let set = MotionSet::new(whole(FRAMES), Some(whole::<Evaluation>(FRAMES)));
    let log = &mut Vec::new();
    train(Stage::VqVae, &config, &set, None, Limits::default(), log).unwrap();
    let (spec, stage) = VelocityStage::<Tracked>::new(&config, &set, None, &FlexDevice).unwrap();
    let poses = |store: &Store| {
        let losses = stage.test(&Parameters::from_store(store, &FlexDevice));
        losses.unwrap()[1]
    };
    let before = poses(&spec.store);
    train(Stage::Velocity, &config, &set, None, Limits::default(), log).unwrap();
    let after = poses(&Decoders::trained(&config).unwrap().store);
    assert!(after < 0.8 * before, "{before} {after}");

    // What is danced comes from them.
    let codes = [vec![1, 5, 3, 3], vec![2, 0, 7, 4]];
    let dance = |config: &Config| {
        let decoder = MotionDecoder::<Flex>::read(config, &FlexDevice).unwrap();
        decoder.positions(&codes).unwrap()
    };
    let learned_on = dance(&config);
    config.velocity.pose_decoders = false;
    let as_they_were = dance(&config);
    let root = |dance: &Positions| dance.index_axis(Axis(1), 0).to_owned();
    assert_eq!(root(&learned_on), root(&as_they_were));
    assert_ne!(learned_on, as_they_were);

    // Side by side they are the same as each alone, for all lengths.
    let shorter = codes.each_ref().map(|half| half[1..].to_vec());
    let reversed = codes.each_ref().map(|half| half.iter().rev().copied().collect());
    let pieces = [codes, reversed, shorter];
    let decoder = MotionDecoder::<Flex>::read(&config, &FlexDevice).unwrap();
    let together = decoder.positions_of_many(&pieces);
    assert_eq!(together.len(), pieces.len());
    for (together, codes) in together.into_iter().zip(&pieces) {
        let (together, alone) = (together.unwrap(), decoder.positions(codes).unwrap());
        assert_eq!(together.dim(), alone.dim());
        let pairs = together.iter().zip(&alone);
        assert!(pairs.into_iter().all(|(one, other)| (one - other).abs() < 1e-4));
    }
}

/// `columns` of training are those of the test.
fn compare<S: TrainableStage<Tracked>>(
    stage: &mut S,
    parameters: &Parameters<Flex>,
    columns: &[usize],
) {
    let state = |stage: &S| {
        let mut checkpoint = Checkpoint::default();
        stage.save(&mut checkpoint);
        checkpoint.tensors
    };
    let before = state(stage);
    let test = stage.test(parameters).unwrap();
    assert_eq!(state(stage), before, "a test changes nothing");
    let metrics = stage.step(&parameters.tracked(), 1).metrics;
    assert_eq!((test.len(), columns.len()), (S::TEST_COLUMNS.len(), columns.len()));
    for (&column, test) in columns.iter().zip(test) {
        let trained = values(&metrics[column])[0];
        assert!(
            (trained - test).abs() < 1e-5 * trained.abs().max(1.0),
            "{column}: {trained} {test}"
        );
    }
}

#[test]
fn without_test_dances_there_is_no_test_loss() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    for test in [None, Some(whole::<Evaluation>(40))] {
        let set = MotionSet::new(whole(FRAMES), test);
        let (spec, mut stage) =
            VqVaeStage::<Tracked>::new(&config, &set, None, &FlexDevice).unwrap();
        let parameters = Parameters::<Flex>::from_store(&spec.store, &FlexDevice);
        stage.step(&parameters.tracked(), 0);
        assert_eq!(stage.test(&parameters), None);
    }
}

/// A run with parts left out, up to its GPT.
fn trained(folder: &Path, ablation: AblationConfig) -> Config {
    let mut config = config(folder);
    config.ablation = ablation;
    (config.data.mirror, config.data.phases) = (false, 1);
    config.run.log_steps = 1;
    (config.velocity.training.steps, config.gpt.training.steps) = (3, 3);
    let set = MotionSet::new(whole(FRAMES), Some(whole(FRAMES)));
    for stage in [Stage::VqVae, Stage::Velocity, Stage::Gpt] {
        let log = &mut Vec::new();
        let outcome = train(stage, &config, &set, None, Limits::default(), log);
        if stage.is_part_of(&config) {
            assert_eq!(outcome.unwrap(), Outcome::Finished);
        } else {
            assert!(matches!(outcome, Err(TrainError::LeftOut { .. })));
        }
    }
    config
}

/// Its codes and its dance for some music.
fn generated(config: &Config) -> ([Vec<i32>; 2], Positions) {
    let policy = Policy::latest(config).unwrap();
    let music = Array2::from_shape_fn((40, 3), |(row, column)| ((row + column) as f32).sin());
    let pieces = ["one", "two"].map(|id| TestPiece::new(id, music.clone()));
    let found = motions::<Tracked>(config, &policy, &pieces, 3, &FlexDevice).unwrap();
    let alone = motions::<Tracked>(config, &policy, &pieces[1..], 3, &FlexDevice).unwrap();
    let other = motions::<Tracked>(config, &policy, &pieces[1..], 4, &FlexDevice).unwrap();
    assert_eq!(found[1], alone[0], "beside another piece");
    // There is one pair of codes to start from; beyond it regression leaves nothing to chance.
    let same = config.ablation.continuous;
    assert_eq!(found[0] == found[1], same);
    assert_eq!(alone == other, same);
    let codes = generated_codes::<Flex>(config, &policy, &pieces, 3, &FlexDevice);
    let dance = found[0].clone().unwrap();
    assert_eq!(dance.dim(), (39 * FRAMES_PER_CODE, 24, 3));
    assert!(dance.iter().all(|value| value.is_finite()));
    (codes[0].clone(), dance)
}

/// How far the root goes in all, in metres.
fn path(dance: &Positions) -> f32 {
    let frames = 1..dance.len_of(Axis(0));
    let step = |frame: usize, axis| dance[[frame, 0, axis]] - dance[[frame - 1, 0, axis]];
    let steps = frames.map(|frame| [0, 1, 2].map(|axis| step(frame, axis).powi(2)));
    steps.map(|squares| squares.iter().sum::<f32>().sqrt()).sum()
}

#[test]
fn runs_with_parts_left_out_learn_and_dance() {
    let whole = AblationConfig::default();
    let cases = [0b0000, 0b0001, 0b0010, 0b0100, 0b0110, 0b1000].map(|flags| AblationConfig {
        separate_halves: flags & 0b0001 > 0,
        root_in_pose: flags & 0b0010 > 0,
        whole_body: flags & 0b0100 > 0,
        continuous: flags & 0b1000 > 0,
    });
    for ablation in cases {
        let folder = tempfile::tempdir().unwrap();
        let config = trained(folder.path(), ablation);
        assert_eq!(folder.path().join("velocity").exists(), !ablation.root_in_pose);
        let (codes, dance) = generated(&config);
        assert_eq!(codes[0] == codes[1], ablation.whole_body, "{ablation:?}");
        assert!(path(&dance) > 0.01, "{ablation:?}: the root stands still");

        let series = read_series(&folder.path().join("vqvae/metrics.csv")).unwrap();
        let value = |name: &str| series[name][0].1;
        let (upper, lower) = (value("upper_loss"), value("lower_loss"));
        let distance = value("upper_commitment");
        assert_eq!(distance == 0.0, ablation.continuous, "{ablation:?}");
        let sum = if ablation.whole_body {
            assert_eq!(upper, lower);
            upper
        } else {
            upper + lower
        };
        assert!((value("loss") - sum).abs() < 1e-5 * sum, "{ablation:?}");

        if ablation != whole {
            let refused = export(&config, false).unwrap_err();
            assert!(matches!(refused, TrainError::LeftOut { .. }), "{refused}");
        }
    }
}

#[test]
fn the_pose_may_include_the_roots_motion() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    config.ablation.root_in_pose = true;
    let piece = piece(dance(40, 1), 0, 0);
    let draw = Draw { start: 8, mirrored: true, ..Draw::default() };
    let [_, lower] = config.pose_columns();
    let crop =
        motion_columns::<Flex>(std::slice::from_ref(&piece), &[draw], 8, &lower, &FlexDevice);
    for (frame, row) in values(&crop).chunks(lower.len()).enumerate() {
        let value = |column| piece.value(8 + frame, column, true);
        assert_eq!(row[..3], [value(0), value(1), value(2)]);
        assert_eq!(row[lower.len() - 1], value(72), "the turn");
    }
}
