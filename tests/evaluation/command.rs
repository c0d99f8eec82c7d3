//! Files that are read, and the command as a user meets it; nothing shared is needed.

use std::{
    collections::BTreeMap,
    num::NonZeroUsize,
    path::{Path, PathBuf},
};

use bailando::{
    evaluation::{BeatsFrom, EvaluationOptions, Metric, Motion, Pose, evaluate, load_motion},
    format::{BvhUnit, Encoding, JsonOptions, to_bvh, to_json},
    motion::{FinishOptions, Positions, forward},
};
use ndarray::ArrayView2;

use crate::{
    motion_support::{dance_of, fixture},
    support::{close, options, sway, write_motion},
};

/// Largest distance of a joint, metres.
fn apart(motion: &Motion, positions: &Positions) -> f64 {
    assert_eq!(motion.poses().len(), positions.dim().0);
    let poses = motion.poses().iter().zip(positions.outer_iter());
    let distance = |(pose, cells): (&Pose, ArrayView2<'_, f32>)| {
        let joints = pose.iter().zip(cells.outer_iter());
        let squares = joints.map(|(place, cell)| {
            let axes = place.to_array().into_iter().zip(&cell);
            axes.map(|(a, &b)| (a - f64::from(b)).powi(2)).sum::<f64>()
        });
        squares.fold(0.0, f64::max).sqrt()
    };
    poses.map(distance).fold(0.0, f64::max)
}

#[test]
fn every_format_of_a_dance_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let dance = dance_of(&fixture("decode_raw.npy"), &FinishOptions::default());
    let read = |name: &str, bytes: Vec<u8>| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        load_motion(&path).unwrap()
    };
    for encoding in [Encoding::Json, Encoding::Base64] {
        let options = JsonOptions {
            encoding,
            ..JsonOptions::default()
        };
        let motion = read("dance.json", to_json(&dance, &options).unwrap());
        assert!(apart(&motion, &dance.positions) < 2e-6, "{encoding:?}");
        assert_eq!(
            motion.codes(),
            Some(&[dance.codes.upper.clone(), dance.codes.lower.clone()])
        );
    }
    let rotated = forward(&dance.skeleton, &dance.animation).unwrap();
    for unit in [BvhUnit::Centimetre, BvhUnit::Metre] {
        let motion = read("dance.bvh", to_bvh(&dance, unit).unwrap().into_bytes());
        // Angles are rounded to 1e-4 degrees.
        assert!(apart(&motion, &rotated) < 1e-4, "{unit:?}");
        assert_eq!(motion.name(), "dance");
    }
    let path = folder.path().join("dance.npy");
    write_motion(&path, &dance.positions);
    assert_eq!(apart(&load_motion(&path).unwrap(), &dance.positions), 0.0);
}

/// A reference folder of six dances, and generated ones named like three of them.
fn folders() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let (reference, generated) = (
        folder.path().join("reference"),
        folder.path().join("generated"),
    );
    for (path, count, offset) in [(&reference, 6, 0.0), (&generated, 3, 0.25)] {
        std::fs::create_dir(path).unwrap();
        for at in 0..count {
            let motion = sway(400, 2.0 + 0.5 * at as f32 + offset);
            write_motion(&path.join(format!("song{at}.npy")), &motion);
        }
    }
    (folder, reference, generated)
}

fn command(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_bailando"))
        .arg("evaluate")
        .args(arguments)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

#[test]
fn the_command_prints_a_table_and_json() {
    let (folder, reference, generated) = folders();
    let beats = folder.path().join("beats.json");
    let table: BTreeMap<String, [u32; 4]> = (0..6)
        .map(|at| (format!("song{at}"), [30, 60, 90, 399]))
        .collect();
    std::fs::write(
        &beats,
        serde_json::json!({"what": "frames", "beats": table}).to_string(),
    )
    .unwrap();
    let common = [
        "--generated",
        generated.to_str().unwrap(),
        "--reference",
        reference.to_str().unwrap(),
        "--beats",
        beats.to_str().unwrap(),
        "--window",
        "100",
    ];
    let (code, json, errors) = command(&[&common[..], &["--json"]].concat());
    assert_eq!(code, Some(0), "{errors}");
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    for row in [&report, &report["reference"]] {
        for key in [
            "fid_k",
            "fid_g",
            "div_k",
            "div_g",
            "beat_align",
            "beat_align_dance",
            "beat_chance",
            "beat_margin",
            "jerk",
            "foot_skate",
        ] {
            assert!(row[key].is_f64(), "{key}: {row}");
        }
    }
    // Windows of 100 frames every 50: 7 in 400 frames.
    assert_eq!(
        (&report["samples"], &report["reference"]["samples"]),
        (&21.into(), &42.into())
    );
    assert!(report["fid_k"].as_f64().unwrap() > 0.1);
    assert!(report["reference"]["fid_k"].as_f64().unwrap().abs() < 1e-3);
    let plot = folder.path().join("plot.svg");
    let (code, table, _) = command(&[&common[..], &["--plot", plot.to_str().unwrap()]].concat());
    assert_eq!(code, Some(0));
    let plot = std::fs::read_to_string(plot).unwrap();
    assert!(plot.starts_with("<svg ") && plot.contains("jerk"), "{plot}");
    assert!(
        table.starts_with("| metric | reference | generated |\n"),
        "{table}"
    );
    assert!(table.contains("windows of 100 frames every 50"), "{table}");
}

#[test]
fn several_seeds_are_a_mean_with_intervals() {
    let (_folder, reference, generated) = folders();
    for seed in ["seed1", "seed2"] {
        let own = generated.join(seed);
        std::fs::create_dir(&own).unwrap();
        for at in 0..3 {
            let pace = 2.0 + 0.5 * at as f32 + if seed == "seed1" { 0.1 } else { 0.2 };
            write_motion(&own.join(format!("song{at}.npy")), &sway(400, pace));
        }
    }
    let seeds = EvaluationOptions {
        seeds: NonZeroUsize::new(2),
        ..options(&generated, &reference)
    };
    let report = evaluate(&seeds).unwrap();
    let each: Vec<f64> = report
        .sets
        .iter()
        .map(|set| set.get(Metric::FidK).unwrap())
        .collect();
    let mean = report.generated.get(Metric::FidK).unwrap();
    close(mean, 0.5 * (each[0] + each[1]), 1e-12, "mean");
    // Two values: 12.7062 times half of their difference.
    close(
        report.margin95["fid_k"],
        12.7062 * 0.5 * (each[0] - each[1]).abs(),
        1e-6,
        "margin",
    );
    let three = EvaluationOptions {
        seeds: NonZeroUsize::new(3),
        ..seeds
    };
    let message = evaluate(&three).unwrap_err().to_string();
    assert!(message.contains("has 2 (seed1, seed2)"), "{message}");
}

#[test]
fn mistakes_are_named() {
    let (folder, reference, generated) = folders();
    let index = serde_json::json!({"pieces": [
        {"id": "song0", "motion": "song0.npy", "split": "train", "audio": "a.ogg"},
        {"id": "song1", "motion": "song1.npy", "split": "test", "audio": "b.ogg"},
        {"id": "song2", "motion": "song2.npy", "split": "test", "audio": "b.ogg"},
        {"id": "song3", "motion": "song3.npy", "split": "test", "audio": "b.ogg"},
    ]});
    std::fs::write(reference.join("index.json"), index.to_string()).unwrap();
    let beats = folder.path().join("beats.json");
    std::fs::write(&beats, r#"{"a.ogg": [3, 5]}"#).unwrap();
    let (generated_text, reference_text) =
        (generated.to_str().unwrap(), reference.to_str().unwrap());
    let base = ["--generated", generated_text, "--reference", reference_text];
    let try_with = |more: &[&str], code: i32, words: &str| {
        let (got, _, errors) = command(&[&base[..], more].concat());
        assert!(
            got == Some(code) && errors.contains(words),
            "{more:?}: {got:?} {errors}"
        );
    };
    try_with(
        &["--json", "--split", "test"],
        0,
        "1 of 3 pieces of split test are missing: song3",
    );
    try_with(&["--json", "--split", "test"], 0, "left out: song0");
    try_with(
        &["--split", "validation"],
        1,
        "no recording of split validation",
    );
    try_with(
        &["--beats", beats.to_str().unwrap()],
        1,
        "no music beats for piece song1",
    );
    try_with(
        &["--music", generated_text],
        1,
        "no audio named song1, b.ogg, b",
    );
    try_with(&["--window", "2"], 2, "too short");
    try_with(&["--stride", "150"], 2, "--window");
    try_with(&["--window", "500"], 1, "the reference: 0 windows");
    write_motion(&generated.join("song9.npy"), &sway(400, 1.0));
    try_with(&[], 1, "song9 is no piece of");
    std::fs::remove_file(generated.join("song9.npy")).unwrap();
    let mut broken = sway(400, 1.0);
    broken[(5, 1, 2)] = f32::NAN;
    write_motion(&generated.join("song0.npy"), &broken);
    try_with(&[], 1, "song0.npy: frame 5, joint 1 is not finite");
    write_motion(&generated.join("song0.npy"), &sway(3, 1.0));
    try_with(&[], 1, "song0.npy: it has 3 frames");
}

/// The demo song's beats are those of its features, whichever way they come.
#[test]
fn music_is_heard_in_audio_files() {
    let (folder, reference, generated) = folders();
    let songs = folder.path().join("songs");
    std::fs::create_dir(&songs).unwrap();
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/audio/demo_44k1_8s.wav");
    for at in 0..6 {
        std::fs::copy(&demo, songs.join(format!("song{at}.wav"))).unwrap();
    }
    let heard = EvaluationOptions {
        beats: BeatsFrom::Audio(songs),
        ..options(&generated, &reference)
    };
    let report = evaluate(&heard).unwrap();
    assert_eq!(
        report.protocol.beats.as_deref(),
        Some("column 53 of the audio's features")
    );
    let score = report.generated.get(Metric::BeatAlign).unwrap();
    assert!(score > 0.0 && score < 1.0, "{score}");
    let chance = report.generated.get(Metric::BeatChance).unwrap();
    let margin = report.generated.get(Metric::BeatMargin).unwrap();
    close(margin, score - chance, 1e-9, "margin");
}

#[test]
fn dances_to_new_songs_are_no_pieces_of_the_reference() {
    let (folder, reference, generated) = folders();
    let songs = folder.path().join("songs");
    std::fs::create_dir(&songs).unwrap();
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/audio/demo_44k1_8s.wav");
    for at in 0..3 {
        let name = format!("new{at}");
        std::fs::copy(&demo, songs.join(&name).with_extension("wav")).unwrap();
        let dance = generated.join(format!("song{at}.npy"));
        std::fs::rename(dance, generated.join(name).with_extension("npy")).unwrap();
    }
    let new = EvaluationOptions {
        beats: BeatsFrom::NewSongs(songs.clone()),
        ..options(&generated, &reference)
    };
    let report = evaluate(&new).unwrap();
    assert!(report.generated.get(Metric::BeatMargin).is_some());
    assert_eq!(report.reference.get(Metric::BeatAlign), None);
    assert!(report.generated.get(Metric::FidK).is_some());
    std::fs::remove_file(songs.join("new1.wav")).unwrap();
    let problem = evaluate(&new).unwrap_err().to_string();
    assert!(problem.contains("no audio named new1"), "{problem}");
}
