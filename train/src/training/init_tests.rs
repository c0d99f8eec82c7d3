//! Weights of `--init` in each of its forms; those of the critic are tested beside `actor-critic`.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use bailando_testkit::model::tiny_dancer;
use burn_autodiff::Autodiff;
use burn_flex::{Flex, FlexDevice};
use ndarray::Array2;

use super::{
    checkpoint::Checkpoint,
    config::MusicColumns,
    frozen::{FrozenVqVae, Halves},
    gpt::Start,
    kept::WEIGHT,
    tests::{FRAMES, config, whole},
    velocity::Decoders,
    vqvae::VqVaeStage,
    *,
};
use crate::{
    HostTensor,
    checkpoint::TorchCheckpoint,
    data::testing,
    export::skeleton,
    weights::{GptWeights, VqVaeWeights},
};

const HEADS: usize = 4;

fn fixture(name: &str) -> PathBuf {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/model");
    Path::new(folder).join(name)
}

/// A motion with music of this many columns, which all vary.
fn set(columns: usize, frame: MotionFrame) -> MotionSet {
    let positions = testing::dance(&skeleton(0.93), FRAMES, 3);
    let value = |(row, column): (usize, usize)| (row as f32 + 0.3 * column as f32).sin() + 2.0;
    let rows = Arc::new(Array2::from_shape_fn((1 + FRAMES / 8, columns), value));
    let piece = MotionPiece::from_positions(positions, frame).unwrap();
    MotionSet::new(Motions::new(vec![piece.with_song(SongRows::new(vec![rows]).unwrap())]), None)
}

#[test]
fn a_vqvae_starts_from_an_official_checkpoint_of_its_sizes() {
    let path = fixture("tiny_vqvae.pt");
    let weights =
        VqVaeWeights::from_checkpoint(&mut TorchCheckpoint::open(&path).unwrap()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    config.data.frame = MotionFrame::World;
    config.vqvae.width = weights.width();
    let codebook = weights.upper.codebook.shape();
    (config.vqvae.codes, config.vqvae.embedding) = (codebook[0], codebook[1]);
    let set = set(3, MotionFrame::World);
    let start = |config: &Config| {
        let stage = VqVaeStage::<Autodiff<Flex>>::new(config, &set, Some(&path), &FlexDevice);
        stage.map(|(spec, _)| spec.store.entries().to_vec())
    };
    let expected = Halves::new(&config, weights);
    assert_eq!(start(&config).unwrap(), expected.store.entries());
    config.vqvae.width *= 2;
    let refused = start(&config).unwrap_err();
    assert!(matches!(refused, TrainError::State { .. }), "{refused}");
}

#[test]
fn a_gpt_starts_from_an_official_checkpoint_as_its_music_is_scaled() {
    let path = fixture("tiny_gpt.pt");
    let checkpoint = &mut TorchCheckpoint::open(&path).unwrap();
    let weights = GptWeights::from_checkpoint(checkpoint, HEADS).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    let upper = weights.upper_embedding.shape();
    config.vqvae.codes = upper[0];
    let gpt = &mut config.gpt;
    (gpt.channels, gpt.heads) = (upper[1], HEADS);
    (gpt.base_layers, gpt.head_layers) = (1, weights.blocks.len() - 1);
    gpt.standardise_music = true;
    let columns = weights.music.weight.shape()[1];
    let set_of = |columns| set(columns, MotionFrame::Dancer);

    let start = Start::read(&config, &set_of(columns), columns, Some(&path)).unwrap();
    let found = start.net.weights(&start.store);
    assert_eq!(found.upper_head, weights.upper_head);
    assert_ne!(found.music.weight, weights.music.weight);
    let folded = start.scale.fold(&found.music);
    let pairs = folded.weight.data().iter().zip(weights.music.weight.data());
    for (folded, official) in pairs {
        assert!((folded - official).abs() < 1e-5, "{folded} {official}");
    }

    let other = Start::read(&config, &set_of(columns + 8), columns + 8, Some(&path));
    let refused = other.err().unwrap();
    assert!(refused.to_string().contains("other sizes"), "{refused}");
    config.gpt.head_layers += 1;
    let other = Start::read(&config, &set_of(columns), columns, Some(&path));
    let refused = other.err().unwrap();
    assert!(refused.to_string().contains("other sizes"), "{refused}");
}

#[test]
fn a_gpt_starts_from_another_run_with_the_same_columns() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    (config.data.mirror, config.data.phases) = (false, 1);
    config.gpt.training.steps = 2;
    config.gpt.standardise_music = true;
    let set = MotionSet::new(whole(FRAMES), None);
    for stage in [Stage::VqVae, Stage::Gpt] {
        let log = &mut Vec::new();
        train(stage, &config, &set, None, Limits::default(), log).unwrap();
    }
    let path = folder.path().join("gpt/checkpoint.safetensors");
    let start = |config: &Config| Start::read(config, &set, 3, Some(&path));
    let checkpoint = Checkpoint::read(&path).unwrap().unwrap();
    let found = start(&config).unwrap();
    let expected = checkpoint.fill(WEIGHT, &found.store).unwrap();
    assert_eq!(found.store.entries(), expected.entries());
    assert_eq!(found.scale.mean, checkpoint.tensor("music.mean").unwrap().data());

    let says = |config: &Config, setting: &str| {
        let refused = start(config).err().unwrap();
        assert!(matches!(refused, TrainError::State { .. }), "{refused}");
        assert!(refused.to_string().contains(setting), "{refused}");
    };
    config.gpt.music_columns = MusicColumns::Rhythm;
    says(&config, "gpt.hear");
    config.gpt.music_columns = MusicColumns::All;
    config.gpt.standardise_music = false;
    says(&config, "gpt.standardise_music");
}

/// Every stage from a model directory, with more codes than it has and the first styles.
#[test]
fn a_run_starts_from_a_model_directory() {
    let base = tiny_dancer();
    let model = ServedModel::open(&base).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut config = model.settings(config(folder.path()));
    let [upper, _] = &model.motion().codebooks;
    let known = upper.dim(0);
    (config.vqvae.codes, config.vqvae.embedding) = (2 * known, upper.dim(1));
    config.vqvae.width = model.motion().halves[0].input.weight.dim(0);
    (config.vqvae.training.steps, config.vqvae.training.rate) = (1, 1e-6);
    config.velocity.training.steps = 1;
    config.velocity.training.rate = 1e-6;
    config.gpt.styles = true;
    let columns = model.gpt().columns();
    let mut set = set(columns, MotionFrame::Dancer);
    set.styles = vec!["house".into(), "krump".into()];
    for stage in [Stage::VqVae, Stage::Velocity] {
        let log = &mut Vec::new();
        train(stage, &config, &set, Some(&base), Limits::default(), log).unwrap();
    }
    let near = |found: &[f32], wanted: &[f32]| {
        let pairs = found.iter().zip(wanted);
        pairs
            .for_each(|(found, wanted)| assert!((found - wanted).abs() < 1e-2, "{found} {wanted}"));
    };
    let frozen = FrozenVqVae::<Flex>::read(&config, &FlexDevice).unwrap();
    let weights = frozen.halves.nets[0].decoder.weights(&frozen.halves.store);
    near(weights.output.weight.data(), model.motion().halves[0].output.weight.data());
    let decoders = Decoders::trained(&config).unwrap();
    let root = decoders.root.weights(&decoders.store);
    let wanted = model.motion().root.as_ref().unwrap();
    near(root.output.weight.data(), wanted.output.weight.data());

    let start = Start::read(&config, &set, columns, Some(&base)).unwrap();
    let found = start.net.weights(&start.store);
    let row = |table: &HostTensor, code: usize| table.rows(code, code + 1);
    let own = &model.gpt().upper_embedding;
    for code in 0..2 * known {
        let embedding = row(&found.upper_embedding, code);
        let alike = (0..known).find(|&own_code| row(own, own_code) == embedding);
        assert!(if code < known { alike == Some(code) } else { alike.is_some() }, "{code}");
    }
    let music = start.scale.fold(&found.music);
    assert_eq!(music.weight.dim(1), columns + 2);
    let channels = music.weight.data().chunks(columns + 2);
    for (found, wanted) in channels.zip(model.gpt().music.weight.data().chunks(columns)) {
        near(&found[..columns], wanted);
        assert_eq!(found[columns..], [0.0, 0.0]);
    }

    let refusal = |config: &Config| {
        let stage = VqVaeStage::<Autodiff<Flex>>::new(config, &set, Some(&base), &FlexDevice);
        stage.err().unwrap().to_string()
    };
    config.vqvae.codes = known - 1;
    assert!(refusal(&config).ends_with("codes: vqvae.codes is less"), "{}", refusal(&config));
    config.data.count_periods = vec![1];
    let refused = refusal(&config);
    assert!(refused.ends_with("was trained with another data.count_periods"), "{refused}");
}
