//! Motions of a run that has no export, through the real binary.

use crate::{common::train, testing, testing::TestFolder};
use std::{fs, path::Path};

use bailando_train::export::skeleton;
use ndarray::Array3;

#[test]
fn a_run_with_separate_halves_dances_but_is_not_exported() {
    let data = TestFolder::good(&skeleton(0.93));
    let data = data.write();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut settings: toml::Table = include_str!("../presets/tiny.toml").parse().unwrap();
    let mut set = |table: &str, name: &str, value: toml::Value| {
        let table = settings.entry(table).or_insert(toml::Table::new().into());
        table.as_table_mut().unwrap().insert(name.into(), value);
    };
    set("data", "folder", data.to_str().unwrap().into());
    set("data", "cache", path("features").into());
    set("run", "folder", path("run").into());
    set("export", "folder", path("model").into());
    set("actor_critic", "enabled", false.into());
    set("ablation", "separate_halves", true.into());
    for stage in ["vqvae", "velocity", "gpt"] {
        let training = settings[stage]["training"].as_table_mut().unwrap();
        training.insert("steps".into(), 3.into());
    }
    let config = path("settings.toml");
    fs::write(&config, settings.to_string()).unwrap();

    let early = train(&["generate", &config, "--out", &path("early")]);
    let message = String::from_utf8(early.stderr).unwrap();
    assert_eq!(early.status.code(), Some(1));
    assert!(message.contains("run `bailando-train gpt` first"), "{message}");
    assert!(!Path::new(&path("early")).exists());

    let run = train(&["run", &config]);
    let report = String::from_utf8(run.stdout).unwrap();
    assert_eq!(run.status.code(), Some(0), "{report}");
    assert!(report.ends_with("export: left out, as parts of the model are ([ablation])\n"));
    assert!(!Path::new(&path("model")).exists());
    let refused = train(&["export", &config]);
    assert_eq!(
        String::from_utf8(refused.stderr).unwrap(),
        "error: export: not with ablation.separate_halves (generate its motion: `bailando-train \
         generate`)\n"
    );

    let dance = |out: &str, seed: &str| -> Array3<f32> {
        let out = path(out);
        let made = train(&["generate", &config, "--out", &out, "--seed", seed]);
        let report = String::from_utf8(made.stdout).unwrap();
        assert_eq!(report, format!("wrote 1 motions to {out}\n"));
        let files: Vec<_> = fs::read_dir(&out).unwrap().collect();
        assert_eq!(files.len(), 1, "one piece of the test split");
        ndarray_npy::read_npy(Path::new(&out).join("three_a.npy")).unwrap()
    };
    let first = dance("first", "1");
    // A code is 8 frames, and the first row of music has none.
    assert_eq!(first.dim(), (testing::FRAMES, 24, 3));
    assert_eq!(first, dance("again", "1"));
    assert_ne!(first, dance("other", "2"));
}
