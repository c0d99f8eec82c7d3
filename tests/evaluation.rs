//! Evaluation against golden values, and the command as a user meets it.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    unreachable_pub,
    reason = "a test says what is wrong by failing"
)]

mod common;
mod evaluation_support;
mod motion_support;

use std::{
    collections::BTreeMap,
    num::NonZeroUsize,
    path::{Path, PathBuf},
};

use bailando::{
    evaluation::{
        BeatScore, BeatsFrom, Clips, EvaluationOptions, FeatureRows, KineticForm, Metric, Motion,
        Pose, Report, Scores, dance_beats, evaluate, load_motion, speed,
    },
    format::{BvhUnit, Encoding, JsonOptions, to_bvh, to_json},
    motion::{FinishOptions, Positions, forward},
};
use evaluation_support::{close, json, random, reversed, rows, sway, write_motion};
use motion_support::{dance_of, fixture};
use ndarray::{Array2, ArrayView2};

fn options(generated: &Path, reference: &Path) -> EvaluationOptions {
    EvaluationOptions {
        generated: generated.to_owned(),
        reference: reference.to_owned(),
        split: None,
        beats: BeatsFrom::default(),
        clips: Clips::default(),
        kinetic: KineticForm::Published,
        seeds: None,
        chance_seed: 0,
    }
}

fn golden_rows(golden: &Path, suffix: &str, motions: &[Motion]) {
    let features = FeatureRows::new(motions, Clips::default(), KineticForm::Published);
    for (name, got) in [
        ("kinetic", features.kinetic),
        ("geometric", features.geometric),
    ] {
        let expected: Array2<f32> = rows(&golden.join(format!("{name}{suffix}.npy")));
        assert_eq!(got.dim(), expected.dim(), "{name}{suffix}");
        for ((at, &got), &expected) in got.indexed_iter().zip(&expected) {
            let expected = f64::from(expected);
            let error = (got - expected).abs();
            assert!(
                error <= 1e-4 * expected.abs(),
                "{name}{suffix} {at:?}: {got} {expected}"
            );
        }
    }
}

/// The ballroom set's motions by id, in the order of the golden files.
fn ballroom(data: &Path, ids: &serde_json::Value) -> Vec<Motion> {
    let ids = ids.as_array().unwrap().iter();
    ids.map(|id| load_motion(&data.join(format!("{}.npy", id.as_str().unwrap()))).unwrap())
        .collect()
}

#[test]
fn features_are_golden() {
    let (Some(golden), Some(data)) = (
        common::shared("evaluation/golden"),
        common::shared("data/dance-with-melody"),
    ) else {
        return;
    };
    let ids = json(&golden.join("ids.json"));
    golden_rows(&golden, "", &ballroom(&data, &ids["reference"]));
    let backwards: Vec<Motion> = ballroom(&data, &ids["reversed"])
        .iter()
        .map(|motion| reversed(motion).0)
        .collect();
    golden_rows(&golden, "_reversed", &backwards);
}

fn check_distances(scores: &Scores, expected: &serde_json::Value) {
    for metric in [Metric::FidK, Metric::FidG, Metric::DivK, Metric::DivG] {
        let expected = expected[metric.key()].as_f64().unwrap();
        close(scores.get(metric).unwrap(), expected, 1e-3, metric.key());
    }
}

#[test]
fn distances_are_golden() {
    let (Some(golden), Some(data)) = (
        common::shared("evaluation/golden"),
        common::shared("data/dance-with-melody"),
    ) else {
        return;
    };
    let expected = json(&golden.join("metrics.json"));
    let ids = json(&golden.join("ids.json"));
    let folder = tempfile::tempdir().unwrap();
    for motion in ballroom(&data, &ids["reversed"]) {
        let (_, positions) = reversed(&motion);
        write_motion(
            &folder.path().join(format!("{}.npy", motion.name())),
            &positions,
        );
    }
    let report = evaluate(&options(folder.path(), &data)).unwrap();
    assert!(report.protocol.constant_kinetic_columns.is_empty());
    check_distances(&report.generated, &expected);
    check_distances(&report.reference, &expected["test_vs_reference"]);
    // The whole set against itself, which is its own "generated" folder.
    let whole = folder.path().join("whole");
    std::fs::create_dir(&whole).unwrap();
    for id in ids["reference"].as_array().unwrap() {
        let name = format!("{}.npy", id.as_str().unwrap());
        std::fs::copy(data.join(&name), whole.join(&name)).unwrap();
    }
    let report = evaluate(&options(&whole, &data)).unwrap();
    for (metric, key) in [
        (Metric::DivK, "reference_div_k"),
        (Metric::DivG, "reference_div_g"),
    ] {
        close(
            report.generated.get(metric).unwrap(),
            expected[key].as_f64().unwrap(),
            1e-3,
            key,
        );
    }
    assert!(report.generated.get(Metric::FidK).unwrap().abs() < 1e-3);
}

#[test]
fn beat_scores_are_golden() {
    let (Some(golden), Some(data)) = (
        common::shared("evaluation/golden"),
        common::shared("data/dance-with-melody"),
    ) else {
        return;
    };
    let expected = json(&golden.join("metrics.json"));
    let index = json(&data.join("index.json"));
    let mut pieces = 0;
    for piece in index["pieces"].as_array().unwrap() {
        let id = piece["id"].as_str().unwrap();
        let golden = &expected["bas_grid_beats"][id];
        let motion = load_motion(&data.join(format!("{id}.npy"))).unwrap();
        let beats = piece["grid_beats_s"].as_array().unwrap().iter();
        let beats: Vec<usize> = beats
            .map(|s| (s.as_f64().unwrap() * 60.0).round_ties_even())
            .filter(|frame| *frame >= 0.0)
            .map(|frame| frame as usize)
            .collect();
        let dance = dance_beats(&speed(motion.poses()));
        assert_eq!(
            dance.len() as u64,
            golden["dance_beats"].as_u64().unwrap(),
            "{id}"
        );
        let score = BeatScore::new(motion.poses().len(), &beats, &dance, &mut random()).unwrap();
        close(score.align, golden["bas"].as_f64().unwrap(), 1e-4, id);
        close(
            score.align_dance,
            golden["beat_align_dance"].as_f64().unwrap(),
            1e-4,
            id,
        );
        pieces += 1;
    }
    assert_eq!(pieces, 52);
}

fn salsa(generated: &Path) -> Option<Report> {
    let data = common::shared("data/salsa")?;
    let salsa = EvaluationOptions {
        split: Some("test".into()),
        beats: BeatsFrom::File(data.join("test_beats.json")),
        clips: Clips::Windows {
            length: 300,
            stride: 150,
        },
        ..options(generated, &data)
    };
    Some(evaluate(&salsa).unwrap())
}

#[test]
fn the_salsa_recordings_have_their_row() {
    let (Some(data), Some(quality)) = (
        common::shared("data/salsa"),
        common::shared("model/bootstrap/quality.json"),
    ) else {
        return;
    };
    let report = salsa(&data).unwrap();
    let row = &json(&quality)["gt"];
    // The data folder as its own generated set is its recordings.
    for scores in [&report.reference, &report.generated] {
        assert_eq!((scores.pieces, scores.samples), (42, 58));
        for (metric, key, tolerance) in [
            (Metric::FidK, "fid_k", 1e-3),
            (Metric::FidG, "fid_g", 1e-3),
            (Metric::DivK, "div_k", 1e-3),
            (Metric::DivG, "div_g", 1e-3),
            (Metric::BeatAlign, "bas", 1e-4),
            (Metric::Jerk, "jerk", 1e-4),
            (Metric::FootSkate, "skate", 1e-4),
        ] {
            close(
                scores.get(metric).unwrap(),
                row[key].as_f64().unwrap(),
                tolerance,
                key,
            );
        }
        // Another generator's shifts: the mean of 42 x 20 of them.
        let chance = scores.get(Metric::BeatChance).unwrap();
        close(chance, row["chance"].as_f64().unwrap(), 0.02, "chance");
    }
    assert_eq!(report.protocol.reference_samples, 292);
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
}

/// A training take recites itself; the test takes are other dances.
#[test]
fn recitation_tells_training_takes_from_others() {
    let Some(data) = common::shared("data/salsa") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    for id in ["60_01", "61_05"] {
        let name = format!("{id}.npy");
        std::fs::copy(data.join(&name), folder.path().join(format!("{id}_a.npy"))).unwrap();
    }
    let report = evaluate(&options(folder.path(), &data)).unwrap();
    assert_eq!(report.generated.get(Metric::Recitation), Some(1.0));
    assert!(report.reference.get(Metric::Recitation).unwrap() < 0.2);
}

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
    let (code, table, _) = command(&common);
    assert_eq!(code, Some(0));
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
