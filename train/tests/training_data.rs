//! Stages on data folders of every layout, and what of them may reach a checkpoint.

use std::{
    collections::BTreeMap,
    f64::consts::TAU,
    fs,
    path::{Path, PathBuf},
};

use crate::common::alone;
use crate::testing::{FRAMES, TestFolder, clicks, dance};
use bailando::{features::Profile, model::CountSource};
use bailando_train::{
    data::{DataFolder, Dataset, FeatureCache, MusicLibrary, MusicSource, OpenOptions, Recording},
    export::skeleton,
    training::{Config, Limits, Load, MotionFrame, MotionSet, Outcome, Stage, export, train},
};
use safetensors::SafeTensors;
use serde_json::json;

const STAGES: [(Stage, Load, &str); 3] = [
    (Stage::VqVae, Load::Motion, "vqvae"),
    (Stage::Velocity, Load::Motion, "velocity"),
    (Stage::Gpt, Load::Music, "gpt"),
];

/// Few steps with the `tiny` preset; run and cache lie in `out`.
fn config(data: &Path, out: &Path) -> Config {
    let mut config = Config::parse(include_str!("../presets/tiny.toml")).unwrap();
    config.data.folder = data.to_owned();
    config.data.cache = out.join("features");
    config.run.folder = out.join("run");
    for training in
        [&mut config.vqvae.training, &mut config.velocity.training, &mut config.gpt.training]
    {
        (training.steps, training.batch) = (3, 2);
    }
    config
}

/// Runs all stages; what they report.
fn run(config: &Config) -> String {
    let mut output = Vec::new();
    for (stage, load, _) in STAGES {
        let set = MotionSet::read(config, load, &mut output).unwrap();
        let outcome = train(stage, config, &set, None, Limits::default(), &mut output);
        assert_eq!(outcome.unwrap(), Outcome::Finished);
    }
    String::from_utf8(output).unwrap()
}

fn checkpoint(config: &Config, stage: &str) -> PathBuf {
    let folder = config.run.folder.join(stage);
    folder.join("checkpoint.safetensors")
}

fn shape(config: &Config, stage: &str, tensor: &str) -> Vec<usize> {
    let bytes = fs::read(checkpoint(config, stage)).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    file.tensor(tensor).unwrap().shape().to_vec()
}

/// Names and bytes of all tensors of a checkpoint.
fn tensors(config: &Config, stage: &str) -> BTreeMap<String, Vec<u8>> {
    let bytes = fs::read(checkpoint(config, stage)).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let tensors = file.iter();
    tensors.map(|(name, tensor)| (name.to_owned(), tensor.data().to_vec())).collect()
}

#[test]
fn our_own_folder_trains_in_the_dancers_frame_and_computes_its_music_once() {
    let _alone = alone();
    let folder = TestFolder::good(&skeleton(0.93));
    let out = tempfile::tempdir().unwrap();
    let config = config(folder.write(), out.path());
    assert_eq!((config.data.frame, config.data.phases), (MotionFrame::Dancer, 2));
    let report = run(&config);
    assert!(report.contains("music of 4/4 songs"), "{report}");
    assert!(report.contains("codes of 2/2 motions"), "{report}");
    // Velocity forward, up and to the left, and the turn.
    assert_eq!(shape(&config, "velocity", "weight.root.output.bias"), [4]);
    assert_eq!(shape(&config, "gpt", "music.mean"), [438]);
    // Three songs of training at two start phases, one of the test split as it is.
    let entries = fs::read_dir(&config.data.cache).unwrap().count();
    assert_eq!(entries, 3 * 2 + 1);
    let mut report = Vec::new();
    MotionSet::read(&config, Load::Music, &mut report).unwrap();
    assert!(report.is_empty(), "all of it is in the cache");
}

/// A folder of a style of its own, with ids and motions that no other has.
fn of_style(style: &str, seed: u32) -> TestFolder {
    let mut folder = TestFolder::good(&skeleton(0.93));
    for (number, name) in (0..).zip(["one", "two", "three"]) {
        folder.motion(&format!("{name}.npy"), &dance(&skeleton(0.93), FRAMES, seed + number));
    }
    for id in ["one_a", "one_b", "two_a", "three_a"] {
        folder.set(id, "style", json!(style));
        folder.set(id, "phrases", json!([{"clip": "x", "start_frame": 0, "bars": 4}]));
        folder.set(id, "damaged", json!([[100, 180]]));
        folder.set(id, "id", json!(format!("{style}_{id}")));
    }
    folder
}

#[test]
fn two_folders_make_a_model_of_their_styles() {
    let _alone = alone();
    let folders = [of_style("sway", 10), of_style("bounce", 20)];
    let out = tempfile::tempdir().unwrap();
    let mut config = config(folders[0].write(), out.path());
    config.data.folders = vec![
        DataFolder { path: folders[0].write().to_owned(), weight: 1.0 },
        DataFolder { path: folders[1].write().to_owned(), weight: 2.0 },
    ];
    config.export.folder = out.path().join("model");
    config.actor_critic.enabled = false;
    (config.gpt.styles, config.gpt.energy) = (true, true);
    (config.gpt.style_drop, config.gpt.recombine) = (0.3, 0.5);
    for balance in
        [&mut config.vqvae.balance, &mut config.velocity.balance, &mut config.gpt.balance]
    {
        (balance.styles, balance.phrases) = (1.0, 0.5);
        (balance.still, balance.damaged) = (0.5, 0.5);
    }
    let report = run(&config);
    assert!(report.contains("codes of 4/4 motions"), "{report}");
    assert_eq!(shape(&config, "gpt", "music.mean"), [438 + 2 + 2]);
    let manifest = export(&config, false).unwrap();
    assert_eq!(manifest.styles, ["bounce", "sway"]);
    assert!(manifest.energy);
    assert_eq!((manifest.features.columns, manifest.conditioning_columns()), (438, 442));

    // Another weight is another training, and so is another style.
    let refused = |config: &Config| {
        let set = MotionSet::read(config, Load::Music, &mut Vec::new()).unwrap();
        let trained = train(Stage::Gpt, config, &set, None, Limits::default(), &mut Vec::new());
        trained.unwrap_err().to_string()
    };
    let mut other = config.clone();
    other.data.folders[1].weight = 3.0;
    assert!(refused(&other).contains("weights of data.folders = [1.0,2.0], now [1.0,3.0]"));
    let third = of_style("glide", 20);
    config.data.folders[1].path = third.write().to_owned();
    assert!(refused(&config).contains("styles = [\"bounce\",\"sway\"]"));
}

#[test]
fn a_model_of_the_networks_counts_is_served_with_them() {
    let _alone = alone();
    let folder = TestFolder::good(&skeleton(0.93));
    let out = tempfile::tempdir().unwrap();
    let mut config = config(folder.write(), out.path());
    (config.data.counts, config.data.count_periods) = (CountSource::Beatnet, vec![1, 8]);
    config.export.folder = out.path().join("model");
    config.actor_critic.enabled = false;
    run(&config);
    let features = export(&config, false).unwrap().features;
    assert_eq!((features.counts, features.count_periods), (CountSource::Beatnet, vec![1, 8]));

    // What is heard of clicks is at the place of the count that the data say.
    let music = MusicSource::Audio(folder.path("a.wav"));
    let cache = FeatureCache::open(&config.data.cache).unwrap();
    let mut heard = MusicLibrary::new(cache, Profile::Librosa011)
        .with_count_periods(&[1], CountSource::Beatnet);
    let rows = heard.conditioning(&music, 0).unwrap();
    let dataset = Dataset::open(folder.write(), &OpenOptions::default()).unwrap();
    let training = dataset.training().unwrap();
    let mut known = training.recordings().iter().flat_map(Recording::known_counts);
    let (_, told) = known.find(|(told, _)| **told == music).unwrap();
    for row in [6, 12, 20] {
        let angle = f64::from(rows[[row, 438]].atan2(rows[[row, 439]]));
        let apart = angle / TAU - told.at(row as f64 / 7.5);
        assert!((apart - apart.round()).abs() < 0.12, "row {row}: {apart}");
    }
    // Another share is another training.
    config.data.heard_counts = 0.5;
    let set = MotionSet::read(&config, Load::Music, &mut Vec::new()).unwrap();
    let trained = train(Stage::Gpt, &config, &set, None, Limits::default(), &mut Vec::new());
    let refused = trained.unwrap_err().to_string();
    assert!(refused.contains("data.heard_counts = 0.0, now 0.5"), "{refused}");
}

#[test]
fn nothing_of_the_test_split_reaches_a_checkpoint() {
    let _alone = alone();
    let folders = [0, 1].map(|_| TestFolder::good(&skeleton(0.93)));
    let absurd = dance(&skeleton(0.93), FRAMES, 9) * 1e6;
    folders[1].motion("three.npy", &absurd);
    fs::write(folders[1].path("d.wav"), clicks(10.0, 0.0, Some(0.05))).unwrap();
    let outs = [0, 1].map(|_| tempfile::tempdir().unwrap());
    let configs = [0, 1].map(|index| config(folders[index].write(), outs[index].path()));
    for mut config in configs.iter().cloned() {
        // Which checkpoint was the best is the one thing that tests decide.
        config.run.test_steps = 0;
        run(&config);
    }
    for (_, _, stage) in STAGES {
        // The best test loss is among the facts, so the tensors are compared.
        let [good, spoiled] = [0, 1].map(|index| tensors(&configs[index], stage));
        assert!(good == spoiled, "{stage} has seen the test split");
    }
}

#[test]
fn the_references_files_train_with_their_own_rows() {
    let _alone = alone();
    let (data, out) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    for (split, seed) in [("train", 1), ("test", 2)] {
        let positions = dance(&skeleton(0.93), 320, seed);
        let flat: Vec<f32> = positions.iter().copied().collect();
        let rows: Vec<Vec<f32>> = (0..41).map(|row| vec![0.1 * row as f32; 438]).collect();
        let file = json!({
            "id": split, "music_array": rows, "dance_array": flat.chunks(72).collect::<Vec<_>>(),
        });
        let folder = data.path().join(split);
        fs::create_dir(&folder).unwrap();
        fs::write(folder.join("a.json"), file.to_string()).unwrap();
    }
    let mut config = config(data.path(), out.path());
    config.data.frame = MotionFrame::World;
    run(&config);
    assert_eq!(shape(&config, "velocity", "weight.root.output.bias"), [3]);
    let set = MotionSet::read(&config, Load::Music, &mut Vec::new()).unwrap();
    assert_eq!(set.test.unwrap().pieces().len(), 1);
}

#[test]
fn aist_dances_train_and_find_their_songs_in_a_folder_of_their_own() {
    let _alone = alone();
    let (folder, out) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (root, songs) = (folder.path().join("aist"), folder.path().join("songs"));
    fs::create_dir_all(root.join("motions")).unwrap();
    fs::create_dir_all(&songs).unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/train");
    let motion = root.join("motions/gBR_sBM_cAll_d04_mBR0_ch01.pkl");
    fs::copy(fixtures.join("aist_protocol4.pkl"), motion).unwrap();
    fs::write(songs.join("mBR0.wav"), clicks(1.0, 0.0, Some(0.5))).unwrap();
    let mut config = config(&root, out.path());
    config.data.audio = songs;
    // The fixture has 12 frames.
    (config.vqvae.frames, config.velocity.frames) = (8, 8);
    for (stage, _, _) in &STAGES[..2] {
        let set = MotionSet::read(&config, Load::Motion, &mut Vec::new()).unwrap();
        let limits = Limits::default();
        train(*stage, &config, &set, None, limits, &mut Vec::new()).unwrap();
    }
    let set = MotionSet::read(&config, Load::Music, &mut Vec::new()).unwrap();
    let dance = &set.training.pieces()[0];
    assert_eq!((dance.frames(), dance.songs().len()), (12, 1));
    assert!(set.test.is_none());
    config.data.audio = root;
    let refused = MotionSet::read(&config, Load::Music, &mut Vec::new()).unwrap_err();
    assert!(refused.to_string().contains("no motion of the training split has music"));
}
