//! Learning from rewards, with tiny networks: what is frozen stays, a resumed run equals an
//! undisturbed one, and the adapted model is served. (That rewards rise is a unit test.)

use crate::testing;
use std::{collections::BTreeMap, fs, path::Path, process::Command, sync::Arc};

use crate::common::{alone, swinging};
use bailando::model::{Manifest, ModelDirectory};
use bailando_train::{
    export::skeleton,
    training::{
        Adaptation, Config, Limits, MotionFrame, MotionPiece, MotionSet, Motions, Outcome,
        ServedModel, Song, SongRows, Stage, TrainError, adapt, export, export_adapted, train,
        trained_weights,
    },
    weights::GptWeights,
};
use ndarray::Array2;
use safetensors::SafeTensors;

fn config(folder: &Path) -> Config {
    let mut config = Config::parse(include_str!("../presets/tiny.toml")).unwrap();
    config.run.folder = folder.join("run");
    config.run.log_steps = 1;
    config.export.folder = folder.join("model");
    config.vqvae.training.steps = 20;
    config.velocity.training.steps = 10;
    config.gpt.training.steps = 20;
    config.actor_critic.continued = 0.5;
    config
}

/// Joints that swing at different rates while the root walks.
fn motion_set() -> MotionSet {
    let piece = |phase: f32| {
        let positions = swinging(phase);
        // Phase 1 starts a frame later.
        let phases = [0.0, 1.0 / 60.0].map(|start| Arc::new(music(phase + start)));
        let piece = MotionPiece::from_positions(positions, MotionFrame::Dancer).unwrap();
        piece.with_song(SongRows::new(phases.into()).unwrap())
    };
    MotionSet {
        training: Motions::new([0.0, 0.7, 1.9].map(piece).into()),
        test: None,
        songs: [0.0, 0.7, 1.9].map(song).into(),
        styles: Vec::new(),
    }
}

fn music(phase: f32) -> Array2<f32> {
    Array2::from_shape_fn((61, 438), |(row, column)| {
        (row as f32 / 7.5 + phase + column as f32).cos() * (1.0 + column as f32 / 50.0)
    })
}

/// A beat every half second.
fn song(phase: f32) -> Song {
    let beats = (0..480).map(|frame| frame % 30 == 0).collect();
    Song { rows: music(phase), beats, style: None }
}

/// A run with its first three stages done.
fn run_to_gpt(folder: &Path) -> Config {
    let config = config(folder);
    let set = motion_set();
    for stage in [Stage::VqVae, Stage::Velocity, Stage::Gpt] {
        let limits = Limits::default();
        let outcome = train(stage, &config, &set, None, limits, &mut Vec::new()).unwrap();
        assert_eq!(outcome, Outcome::Finished);
    }
    config
}

/// The same stages under another folder.
fn copied(config: &Config, folder: &Path) -> Config {
    let mut copy = config.clone();
    copy.run.folder = folder.join("run");
    copy.export.folder = folder.join("model");
    for stage in ["vqvae", "velocity", "gpt"] {
        let target = copy.run.folder.join(stage);
        fs::create_dir_all(&target).unwrap();
        for file in fs::read_dir(config.run.folder.join(stage)).unwrap() {
            let file = file.unwrap();
            fs::copy(file.path(), target.join(file.file_name())).unwrap();
        }
    }
    copy
}

fn steps(most: u64) -> Limits {
    Limits { steps: Some(most), ..Limits::default() }
}

/// Values of a column of `metrics.csv`, by step.
fn column(folder: &Path, column: usize) -> Vec<f32> {
    let text = fs::read_to_string(folder.join("metrics.csv")).unwrap();
    let lines = text.lines().skip(1);
    lines.map(|line| line.split(',').nth(column).unwrap().parse().unwrap()).collect()
}

/// Bytes of the weights of a checkpoint, by name.
fn weights(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let bytes = fs::read(folder.join("checkpoint.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let tensors = file.iter().filter_map(|(name, view)| {
        let name = name.strip_prefix("weight.")?;
        Some((name.to_owned(), view.data().to_vec()))
    });
    let mut tensors: Vec<_> = tensors.collect();
    tensors.sort();
    tensors
}

// One test: stages are expensive to get to.
#[test]
fn rewards_move_the_policy() {
    let _alone = alone();
    let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let [first, second] = folders.each_ref().map(|folder| folder.path());
    let config = run_to_gpt(first);

    let broken = copied(&config, second);
    resumes_exactly(&config, &broken, &motion_set());
    only_policy_and_critic_move(&config);
    adapts(&config, first);
    adapts_a_model(&config, first);
}

fn resumes_exactly(whole: &Config, broken: &Config, set: &MotionSet) {
    let run = |config: &Config, limits| {
        train(Stage::ActorCritic, config, set, None, limits, &mut Vec::new()).unwrap()
    };
    // 3 pieces of 40 codes have 36 windows, so an epoch is 3 steps: within, and between epochs.
    for limits in [steps(1), steps(2), steps(1), steps(4)] {
        assert_eq!(run(broken, limits), Outcome::Paused);
    }
    // Not finished yet: the model would be that of `gpt`.
    let (_, policy, _) = trained_weights(broken).unwrap();
    assert_eq!(run(broken, Limits::default()), Outcome::Finished);
    let (_, learned, _) = trained_weights(broken).unwrap();
    assert_eq!(policy.music, learned.music);
    assert_ne!(policy.upper_head, learned.upper_head);

    assert_eq!(run(whole, Limits::default()), Outcome::Finished);
    assert_eq!(column(&whole.run.folder.join("actor-critic"), 0).len(), 12);
    for file in ["metrics.csv", "checkpoint.safetensors"] {
        let read =
            |config: &Config| fs::read(config.run.folder.join("actor-critic").join(file)).unwrap();
        assert!(read(whole) == read(broken), "{file} differs after resuming");
    }
    let mut without = whole.clone();
    without.actor_critic.enabled = false;
    let (_, plain, _) = trained_weights(&without).unwrap();
    assert_eq!(plain, policy);
    keeps_a_share(whole, &plain, &learned);
}

/// What rewards changed is kept as far as asked, without learning again.
fn keeps_a_share(config: &Config, plain: &GptWeights, learned: &GptWeights) {
    let kept = |share: f64| {
        let mut config = config.clone();
        config.actor_critic.kept = share;
        let (_, weights, _) = trained_weights(&config).unwrap();
        weights
    };
    assert_eq!(kept(0.0), *plain);
    let head = |weights: &GptWeights| weights.upper_head.data().to_vec();
    let ends = head(plain).into_iter().zip(head(learned));
    for (found, (from, to)) in head(&kept(0.25)).into_iter().zip(ends) {
        let (from, to) = (f64::from(from), f64::from(to));
        assert_eq!(found, (from + 0.25 * (to - from)) as f32);
    }
}

/// The state network stays bit for bit; everything of policy and critic has moved.
fn only_policy_and_critic_move(config: &Config) {
    let before = weights(&config.run.folder.join("gpt"));
    let after = weights(&config.run.folder.join("actor-critic"));
    let state = |name: &str| {
        let parts = ["music.", "upper_embedding", "lower_embedding", "positions", "blocks.0."];
        parts.iter().any(|part| name.starts_with(part))
    };
    assert_eq!(before.iter().filter(|(name, _)| state(name)).count(), 21);
    for (name, values) in &before {
        let (_, learned) = after.iter().find(|(other, _)| other == name).unwrap();
        // A key's bias shifts all scores of a query alike: it has no derivative worth the name.
        if !name.ends_with("key.bias") {
            assert_eq!(values == learned, state(name), "{name}");
        }
    }
    let critic = after.iter().filter(|(name, _)| name.starts_with("critic."));
    assert_eq!(critic.count(), 16 + 2 + 2);
}

fn adapts(config: &Config, folder: &Path) {
    let path = folder.join("song.wav");
    fs::write(&path, b"only its hash matters here").unwrap();
    let adaptation = Adaptation::new(config, vec![(path.clone(), song(0.4))], None).unwrap();
    let run = |limits| adapt(config, &adaptation, None, limits, &mut Vec::new()).unwrap();
    assert_eq!(run(steps(2)), Outcome::Paused);
    let out = folder.join("adapted");
    assert!(matches!(
        export_adapted(config, &adaptation, &out, false),
        Err(TrainError::StageMissing { .. })
    ));
    // The same bytes under another name resume.
    let other = folder.join("renamed.wav");
    fs::copy(&path, &other).unwrap();
    let renamed = Adaptation::new(config, vec![(other, song(0.4))], None).unwrap();
    assert_eq!(renamed.folder, adaptation.folder);
    assert_eq!(run(Limits::default()), Outcome::Finished);
    assert_eq!(column(&adaptation.folder.join("adapt"), 0).len(), 6);

    export(config, false).unwrap();
    let manifest = export_adapted(config, &adaptation, &out, false).unwrap();
    assert_eq!(manifest.training["adapted_to"], "song.wav");
    let model = ModelDirectory::open(&out).unwrap();
    model.gpt(1).unwrap();
    let plain = ModelDirectory::open(&config.export.folder).unwrap();
    assert_eq!(model.manifest().start_codes, plain.manifest().start_codes);
    let hash = |model: &ModelDirectory, file: &str| model.manifest().files[file].sha256.clone();
    assert_ne!(hash(&model, "gpt.onnx"), hash(&plain, "gpt.onnx"));
    assert_eq!(hash(&model, "decoder.onnx"), hash(&plain, "decoder.onnx"));
}

/// The same from the model directory alone: nothing of the run is needed.
fn adapts_a_model(config: &Config, folder: &Path) {
    let path = folder.join("song.wav");
    let model = ServedModel::open(&config.export.folder).unwrap();
    let mut other = Config::parse(include_str!("../presets/tiny.toml")).unwrap();
    other.run.folder = folder.join("elsewhere");
    (other.gpt.block, other.gpt.channels, other.data.frame) = (4, 12, MotionFrame::World);
    let other = model.settings(other);
    assert_eq!((other.gpt.block, other.gpt.channels), (config.gpt.block, config.gpt.channels));
    assert_eq!(other.gpt.base_layers, config.gpt.base_layers);
    assert_eq!(other.data.frame, config.data.frame);
    let second = folder.join("second.wav");
    fs::write(&second, b"another").unwrap();
    let songs = vec![(path, song(0.4)), (second, song(0.9))];
    let adaptation = Adaptation::new(&other, songs, Some(model)).unwrap();
    let run = |limits| adapt(&other, &adaptation, None, limits, &mut Vec::new()).unwrap();
    assert_eq!(run(steps(1)), Outcome::Paused);
    assert_eq!(run(Limits::default()), Outcome::Finished);
    let out = folder.join("adapted-model");
    export_adapted(&other, &adaptation, &out, false).unwrap();
    let [before, after] = [&config.export.folder, &out].map(|path| {
        let directory = ModelDirectory::open(path).unwrap();
        directory.gpt(1).unwrap();
        directory.manifest().clone()
    });
    assert_eq!(after.training["adapted_to"], serde_json::json!(["song.wav", "second.wav"]));
    assert_eq!(after.training["checkpoints"], before.training["checkpoints"]);
    for (name, entry) in &before.files {
        assert_eq!(after.files[name] == *entry, name != "gpt.onnx", "{name}");
    }
    let same = |manifest: Manifest| Manifest {
        files: BTreeMap::new(),
        training: BTreeMap::new(),
        ..manifest
    };
    assert_eq!(same(after), same(before));
}

/// From a data folder and an audio file to two model directories, by the commands themselves.
#[test]
fn commands_train_and_adapt() {
    let _alone = alone();
    let data = testing::TestFolder::good(&skeleton(0.93));
    data.write();
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("settings.toml");
    let mut text: toml::Table = include_str!("../presets/tiny.toml").parse().unwrap();
    let more = format!(
        "[data]\nfolder = {:?}\n[run]\nfolder = {:?}\n[export]\nfolder = {:?}",
        data.path(""),
        folder.path().join("run"),
        folder.path().join("model"),
    );
    let more: toml::Table = more.parse().unwrap();
    for (name, table) in more {
        let section = text.entry(name).or_insert(toml::Table::new().into());
        section.as_table_mut().unwrap().extend(table.as_table().unwrap().clone());
    }
    for stage in ["vqvae", "velocity", "gpt"] {
        text[stage]["training"]["steps"] = 4.into();
    }
    fs::write(&settings, text.to_string()).unwrap();
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_bailando-train"))
            .arg(arguments[0])
            .arg(&settings)
            .args(&arguments[1..])
            .env("XDG_CACHE_HOME", folder.path())
            .output()
            .unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments:?}: {error}");
        String::from_utf8(output.stdout).unwrap()
    };
    for stage in ["vqvae", "velocity", "gpt", "actor-critic", "export"] {
        run(&[stage]);
    }
    let song = data.path("d.wav");
    let song = ["adapt", "--song", song.to_str().unwrap()];
    let paused = run(&[&song[..], &["--max-steps", "1"]].concat());
    assert!(paused.contains("paused"), "{paused}");
    let out = folder.path().join("adapted");
    let wrote = run(&[&song[..], &["--out", out.to_str().unwrap()]].concat());
    assert!(wrote.contains("adapted"), "{wrote}");
    let model = ModelDirectory::open(&out).unwrap();
    assert_eq!(model.manifest().training["adapted_to"], "d.wav");

    // From a model directory, and from the run by way of one: dances are made and imitated.
    for (name, value) in [("candidates", 2), ("dances", 2), ("stride", 1)] {
        text["adapt"].as_table_mut().unwrap().insert(name.into(), value.into());
    }
    fs::write(&settings, text.to_string()).unwrap();
    for (name, start) in [("imitated", &["--model", out.to_str().unwrap()][..]), ("of run", &[])] {
        let to = folder.path().join(name);
        let paused = run(&[&song[..], start, &["--max-steps", "1"]].concat());
        assert!(paused.contains("dance 2/2") && paused.contains("paused"), "{paused}");
        let resumed = run(&[&song[..], start, &["--out", to.to_str().unwrap()]].concat());
        assert!(!resumed.contains("dance 1/2") && resumed.contains("finished"), "{resumed}");
        let model = ModelDirectory::open(&to).unwrap();
        assert!((1..=2).contains(&model.manifest().start_codes.len()));
    }
}
