//! `run` as the operating system may treat it: killed at points in time drawn at random, the real
//! binary ends with the same files, byte for byte, as when nobody disturbs it.

use std::{
    collections::BTreeMap,
    fs,
    io::{BufRead, BufReader},
    os::unix::process::ExitStatusExt,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    thread::sleep,
    time::{Duration, SystemTime},
};

use crate::testing::TestFolder;
use bailando::{
    engine::{Engine, EngineConfig, GenerationOptions, GenerationRequest},
    model::ModelDirectory,
};
use bailando_train::export::skeleton;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use toml::{Table, Value};

/// Stages, their tables of settings, and whether they measure a test loss.
const STAGES: [(&str, &str, bool); 4] = [
    ("vqvae", "vqvae", true),
    ("velocity", "velocity", true),
    ("gpt", "gpt", true),
    ("actor-critic", "actor_critic", false),
];
const STEPS: u64 = 24;
const SIGKILL: i32 = 9;
/// Set to what a failed test printed, it kills at the same steps.
const SEED: &str = "BAILANDO_KILL_SEED";

/// A run of the `tiny` sizes in `folder`, with the best weights taken on; its settings file.
fn settings(data: &Path, folder: &Path, checkpoint_seconds: f64) -> PathBuf {
    let mut settings: Table = include_str!("../presets/tiny.toml").parse().unwrap();
    let text = |path: PathBuf| Value::from(path.to_str().unwrap());
    let mut set = |table: &str, name: &str, value: Value| {
        let table = settings.entry(table).or_insert(Table::new().into());
        table.as_table_mut().unwrap().insert(name.into(), value);
    };
    set("data", "folder", text(data.to_owned()));
    set("data", "cache", text(data.join("features")));
    // What the published settings leave out has random numbers of its own, and columns of its own.
    set("data", "count_periods", vec![Value::from(1), 4.into()].into());
    set("gpt", "code_noise", 0.1.into());
    set("run", "folder", text(folder.join("run")));
    set("run", "log_steps", 2.into());
    set("run", "test_steps", 5.into());
    set("run", "checkpoint_seconds", checkpoint_seconds.into());
    set("export", "folder", text(folder.join("model")));
    for (_, table, _) in STAGES.iter().filter(|(.., tested)| *tested) {
        set(table, "use", "best".into());
    }
    for (_, table, _) in STAGES {
        let training = settings[table]["training"].as_table_mut().unwrap();
        training.insert("steps".into(), (STEPS as i64).into());
    }
    let path = folder.join("run.toml");
    fs::write(&path, settings.to_string()).unwrap();
    path
}

fn command(settings: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bailando-train"));
    command.arg("run").arg(settings);
    command
}

#[track_caller]
fn finish(settings: &Path) -> String {
    let output = command(settings).output().unwrap();
    let text = texts(&output);
    assert!(output.status.success(), "{text}");
    text
}

fn texts(output: &Output) -> String {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}

/// Stage and step of a line of progress.
fn place(line: &str) -> Option<(usize, u64)> {
    let mut words = line.split(' ');
    let stage = words.next()?;
    let stage = STAGES.iter().position(|&(name, ..)| name == stage)?;
    Some((stage, words.next()?.split('/').next()?.parse().ok()?))
}

/// Kills the run a moment after it reported `target` or more.
fn kill_at(settings: &Path, target: (usize, u64), moment: Duration) {
    let mut child = command(settings).stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut places = lines.filter_map(|line| place(&line.unwrap()));
    let reached = places.find(|&place| place >= target);
    assert!(reached.is_some(), "ended before {target:?}");
    sleep(moment);
    child.kill().unwrap();
    assert_eq!(child.wait().unwrap().signal(), Some(SIGKILL), "{target:?}");
}

/// Content of every file below a folder, by its path in there.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().to_owned();
                found.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    found
}

#[track_caller]
fn same(whole: &Path, broken: &Path) {
    for part in ["run", "model"] {
        let (whole, broken) = (files(&whole.join(part)), files(&broken.join(part)));
        let names = |files: &BTreeMap<PathBuf, _>| -> Vec<_> { files.keys().cloned().collect() };
        assert_eq!(names(&whole), names(&broken));
        for (name, content) in &whole {
            assert!(content == &broken[name], "{} differs", name.display());
        }
    }
}

/// The engine dances to a song with the model, counts included.
fn dances(model: &Path, song: &Path) {
    let engine = Engine::open(&EngineConfig { threads: 1, ..EngineConfig::new(model) }).unwrap();
    let features = &engine.manifest().features;
    assert_eq!((features.columns, &features.count_periods[..]), (442, &[1, 4][..]));
    let options = GenerationOptions { seed: Some(1), ..GenerationOptions::default() };
    let song = fs::read(song).unwrap();
    let output = engine.generate(GenerationRequest::audio(song, options)).unwrap();
    let dance = output.into_motion(engine.manifest());
    assert_eq!(dance.positions.dim(), (10 * 60, 24, 3));
    assert_eq!(dance.music, None, "beats that were not asked for");
    assert!(dance.positions.iter().all(|value| value.is_finite()));
}

#[test]
fn a_run_that_is_killed_ends_as_one_that_is_not() {
    let seed = std::env::var(SEED).ok().map(|seed| seed.parse().unwrap());
    let now = SystemTime::UNIX_EPOCH.elapsed().unwrap();
    let seed: u64 = seed.unwrap_or(now.subsec_nanos().into());
    println!("{SEED}={seed}");
    let mut random = ChaCha8Rng::seed_from_u64(seed);

    let data = TestFolder::good(&skeleton(0.93));
    let folders = [0, 1].map(|_| tempfile::tempdir().unwrap());
    let [whole, broken] = [0, 1].map(|index| folders[index].path());
    let undisturbed = settings(data.write(), whole, 60.0);
    let disturbed = settings(data.write(), broken, 0.05);
    let report = finish(&undisturbed);
    let model = whole.join("model");
    let last = format!("try it: bailando serve --model-dir {}", model.display());
    assert_eq!(report.lines().last(), Some(last.as_str()), "{report}");
    for (stage, _, tested) in STAGES {
        let files = files(&whole.join("run").join(stage));
        let has = |name: &str| files.contains_key(Path::new(name));
        for name in ["checkpoint.safetensors", "loss.svg", "metrics.csv"] {
            assert!(has(name), "{stage}/{name}");
        }
        assert_eq!(has("best.safetensors"), tested, "{stage}");
    }

    dances(&model, &data.path("a.wav"));

    for (stage, (name, ..)) in STAGES.iter().enumerate() {
        let step = 1 + random.next_u64() % (STEPS / 2);
        let moment = Duration::from_millis(random.next_u64() % 60);
        println!("kill in {name} after step {step} and {moment:?}");
        kill_at(&disturbed, (stage, step), moment);
    }
    finish(&disturbed);
    same(whole, broken);

    // Nothing is left to do, so the data are not needed any more.
    fs::remove_file(data.path("index.json")).unwrap();
    let report = finish(&disturbed);
    for (stage, ..) in STAGES {
        assert!(report.contains(&format!("{stage}: finished before\n")), "{report}");
    }
    same(whole, broken);
    another_default_is_another_model(&disturbed, &broken.join("model"));
}

/// The same stages, asked to be described otherwise.
fn another_default_is_another_model(settings: &Path, model: &Path) {
    let mut table: Table = fs::read_to_string(settings).unwrap().parse().unwrap();
    let export = table["export"].as_table_mut().unwrap();
    export.insert("candidates".into(), 2.into());
    fs::write(settings, table.to_string()).unwrap();
    let output = command(settings).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(texts(&output).contains("already there"), "{output:?}");
    let output = command(settings).arg("--force").output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let manifest = ModelDirectory::open(model).unwrap();
    assert_eq!(manifest.manifest().sampling.candidates, 2);
}

#[test]
fn an_interrupt_writes_a_checkpoint() {
    let data = TestFolder::good(&skeleton(0.93));
    let folder = tempfile::tempdir().unwrap();
    // Without the interrupt there is no checkpoint before the stage's end.
    let path = settings(data.write(), folder.path(), 1e9);
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("steps = 24", "steps = 100000")).unwrap();
    for signal in ["INT", "TERM"] {
        let mut child = command(&path).stdout(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let line = lines.by_ref().map(|line| line.unwrap()).find(|line| place(line).is_some());
        let (_, reported) = place(&line.unwrap()).unwrap();
        let id = child.id().to_string();
        let sent = Command::new("kill").args(["-s", signal, &id]).status().unwrap();
        assert!(sent.success());
        let last = lines.last().unwrap().unwrap();
        assert_eq!(last, "paused: the same command resumes", "{signal}");
        assert_eq!(child.wait().unwrap().code(), Some(130), "{signal}");
        let bytes = fs::read(folder.path().join("run/vqvae/checkpoint.safetensors")).unwrap();
        let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).unwrap();
        let facts = &header.metadata().as_ref().unwrap()["facts"];
        let facts: serde_json::Value = serde_json::from_str(facts).unwrap();
        let step: u64 = facts["step"].as_str().unwrap().parse().unwrap();
        assert!(step >= reported, "{signal}: {step} {reported}");
    }
}

#[test]
fn a_limit_pauses_and_a_model_in_the_way_is_told_at_once() {
    let data = TestFolder::good(&skeleton(0.93));
    let folder = tempfile::tempdir().unwrap();
    let settings = settings(data.write(), folder.path(), 60.0);
    let output = command(&settings).args(["--max-seconds", "0"]).output();
    let report = texts(&output.unwrap());
    assert_eq!(report, "paused: the same command resumes\n");
    let checkpoint = folder.path().join("run/vqvae/checkpoint.safetensors");
    let paused = fs::read(&checkpoint).unwrap();

    fs::create_dir(folder.path().join("model")).unwrap();
    fs::write(folder.path().join("model/manifest.json"), "{}").unwrap();
    let output = command(&settings).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(texts(&output).lines().count(), 1);
    assert!(fs::read(&checkpoint).unwrap() == paused);
}
