//! What the stages take from their data, and how test losses compare with those of training.

use std::{path::Path, sync::Arc};

use bailando::motion::Positions;
use burn_autodiff::Autodiff;
use burn_flex::{Flex, FlexDevice};
use ndarray::{Array2, Axis, Slice};

use super::{
    codes::{Augmentation, Codes},
    gpt::GptWork,
    runner::Work,
    saved::Saved,
    velocity::VelocityWork,
    vqvae::{Trained, VqVaeWork, half_crops},
    *,
};
use crate::{
    data::{Draw, Evaluation, Motion, SplitKind, mirrored, testing},
    export::skeleton,
    nn::{Parameters, values},
};

type Tracked = Autodiff<Flex>;

const FRAMES: usize = 301;

fn config(folder: &Path) -> Config {
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

fn whole<S: SplitKind>(frames: usize) -> Dances<S> {
    Dances::new(vec![piece(dance(frames, 3), 1, 1)])
}

fn part(positions: &Positions, from: usize) -> Positions {
    let frames = Slice::from(from..);
    positions.slice_axis(Axis(0), frames).to_owned()
}

fn codes<B: crate::nn::Kernels<Device = FlexDevice>>(
    frozen: &Trained<B>,
    piece: &MotionPiece,
) -> [Vec<i32>; 2] {
    let frames = piece.frames() / FRAMES_PER_CODE * FRAMES_PER_CODE;
    let whole = Draw {
        dance: 0,
        song: 0,
        phase: 0,
        start: 0,
        mirrored: false,
    };
    let piece = std::slice::from_ref(piece);
    [0, 1].map(|half| {
        let motion = half_crops(piece, &[whole], frames, half, &FlexDevice);
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
    let set = MotionSet {
        training: Dances::new(pieces.into()),
        test: None,
    };
    let log = &mut Vec::new();
    train(Stage::VqVae, &config, &set, None, Limits::default(), log).unwrap();

    let frozen = Trained::<Flex>::read(&config, &FlexDevice).unwrap();
    let wanted = Augmentation {
        mirror: true,
        phases: 8,
    };
    let found = Codes::encode(&frozen, set.training.pieces(), wanted, &FlexDevice, log);
    for (index, positions) in positions.iter().enumerate() {
        for phase in 0..8 {
            for side in [false, true] {
                let motion = Motion::new(part(positions, phase));
                let motion = if side { mirrored(&motion) } else { motion };
                let expected = codes(&frozen, &piece(motion.into_positions(), 0, 0));
                let draw = Draw {
                    dance: index,
                    song: 0,
                    phase,
                    start: 0,
                    mirrored: side,
                };
                assert_eq!(found.of(&draw), &expected, "{draw:?}");
            }
        }
    }
    assert_eq!(found.starts().count(), 4);

    let (plan, work) = GptWork::<Tracked>::new(&config, &set, None, &FlexDevice, log).unwrap();
    assert_eq!(plan.windows, (37 - 29) + (31 - 29));
    let block = config.gpt.block;
    let crops = crate::data::CropPlan {
        frames: 8 * (block + 1),
        stride: 8,
        mirror: true,
    };
    for draw in crops.round(&set.training.music_choices(8), 5, 0) {
        let rows = values(&work.music::<Flex>(set.training.pieces(), &[draw]));
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
    for training in [
        &mut config.vqvae.training,
        &mut config.velocity.training,
        &mut config.gpt.training,
    ] {
        training.batch = 1;
    }
    (config.vqvae.frames, config.velocity.frames) = (240, 240);
    let set = MotionSet {
        training: whole(240),
        test: Some(whole::<Evaluation>(240)),
    };
    let log = &mut Vec::new();

    let (plan, mut work) = VqVaeWork::<Tracked>::new(&config, &set, None, &FlexDevice).unwrap();
    let parameters = Parameters::<Flex>::from_store(&plan.store, &FlexDevice);
    assert_eq!(work.test(&parameters), None, "no codes yet");
    work.step(&parameters.tracked(), 0);
    compare(&mut work, &parameters, &[0, 2, 9]);

    train(Stage::VqVae, &config, &set, None, Limits::default(), log).unwrap();
    let (plan, mut work) = VelocityWork::<Tracked>::new(&config, &set, &FlexDevice).unwrap();
    let parameters = Parameters::from_store(&plan.store, &FlexDevice);
    compare(&mut work, &parameters, &[0]);
    let output = plan
        .store
        .entries()
        .iter()
        .find(|(name, _)| name == "root.output.bias");
    assert_eq!(output.unwrap().1.shape(), [4]);

    let (plan, mut work) = GptWork::<Tracked>::new(&config, &set, None, &FlexDevice, log).unwrap();
    let parameters = Parameters::from_store(&plan.store, &FlexDevice);
    compare(&mut work, &parameters, &[0, 1, 2]);
}

/// `columns` of training are those of the test.
fn compare<W: Work<Tracked>>(work: &mut W, parameters: &Parameters<Flex>, columns: &[usize]) {
    let state = |work: &W| {
        let mut saved = Saved::default();
        work.save(&mut saved);
        saved.tensors
    };
    let before = state(work);
    let test = work.test(parameters).unwrap();
    assert_eq!(state(work), before, "a test changes nothing");
    let metrics = work.step(&parameters.tracked(), 1).metrics;
    assert_eq!(
        (test.len(), columns.len()),
        (W::TEST_COLUMNS.len(), columns.len())
    );
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
        let set = MotionSet {
            training: whole(FRAMES),
            test,
        };
        let (plan, mut work) = VqVaeWork::<Tracked>::new(&config, &set, None, &FlexDevice).unwrap();
        let parameters = Parameters::<Flex>::from_store(&plan.store, &FlexDevice);
        work.step(&parameters.tracked(), 0);
        assert_eq!(work.test(&parameters), None);
    }
}
