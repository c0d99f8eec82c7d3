//! `bailando evaluate` as a user meets it.

use std::{collections::BTreeMap, fs};

use bailando_testkit::motion::{folders, sway, write_motion};

/// Exit code, standard output and standard error; the arguments are separated by spaces.
fn evaluate(arguments: &str) -> (Option<i32>, String, String) {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_bailando"))
        .arg("evaluate")
        .args(arguments.split_whitespace())
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    let (answer, errors) = (text(output.stdout), text(output.stderr));
    (output.status.code(), answer, errors)
}

#[test]
fn the_command_prints_a_table_and_json() {
    let (folder, reference, generated) = folders();
    let [beats, plot] = ["beats.json", "plot.svg"].map(|name| folder.path().join(name));
    let songs = (0..6).map(|at| (format!("song{at}"), [30, 60, 90, 399]));
    let table: BTreeMap<String, [u32; 4]> = songs.collect();
    let document = serde_json::json!({"what": "frames", "beats": table});
    fs::write(&beats, document.to_string()).unwrap();
    let [generated, reference] = [&generated, &reference].map(|folder| folder.display());
    let common = format!(
        "--generated {generated} --reference {reference} --beats {} --window 100",
        beats.display()
    );
    let (code, json, errors) = evaluate(&format!("{common} --json"));
    assert_eq!(code, Some(0), "{errors}");
    let report: serde_json::Value = serde_json::from_str(&json).unwrap();
    let distances = ["fid_k", "fid_g", "div_k", "div_g", "jerk", "foot_skate"];
    let beats = ["beat_align", "beat_align_dance", "beat_chance", "beat_margin"];
    for row in [&report, &report["reference"]] {
        for key in distances.iter().chain(&beats) {
            assert!(row[key].is_f64(), "{key}: {row}");
        }
    }
    // Windows of 100 frames every 50: 7 in 400 frames.
    assert_eq!(report["samples"], 21);
    assert_eq!(report["reference"]["samples"], 42);
    assert!(report["fid_k"].as_f64().unwrap() > 0.1);
    assert!(report["reference"]["fid_k"].as_f64().unwrap().abs() < 1e-3);
    let (code, table, _) = evaluate(&format!("{common} --plot {}", plot.display()));
    assert_eq!(code, Some(0));
    let plot = fs::read_to_string(plot).unwrap();
    assert!(plot.starts_with("<svg ") && plot.contains("jerk"), "{plot}");
    let head = "| metric | reference | generated |\n";
    assert!(table.starts_with(head), "{table}");
    assert!(table.contains("windows of 100 frames every 50"), "{table}");
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
    fs::write(reference.join("index.json"), index.to_string()).unwrap();
    let beats = folder.path().join("beats.json");
    fs::write(&beats, r#"{"a.ogg": [3, 5]}"#).unwrap();
    let folders =
        format!("--generated {} --reference {}", generated.display(), reference.display());
    let try_with = |more: &str, code: i32, words: &str| {
        let (got, _, errors) = evaluate(&format!("{folders} {more}"));
        let right = got == Some(code) && errors.contains(words);
        assert!(right, "{more}: {got:?} {errors}");
    };
    let beats = format!("--beats {}", beats.display());
    let music = format!("--music {}", generated.display());
    let lacking = "1 of 3 pieces of split test are missing: song3";
    for (more, code, words) in [
        ("--json --split test", 0, lacking),
        ("--json --split test", 0, "left out: song0"),
        ("--split validation", 1, "no recording of split validation"),
        (&beats, 1, "no music beats for piece song1"),
        (&music, 1, "no audio named song1, b.ogg, b"),
        ("--form", 2, "found from their beats"),
        ("--window 2", 2, "too short"),
        ("--stride 150", 2, "--window"),
        ("--window 500", 1, "the reference: 0 windows"),
    ] {
        try_with(more, code, words);
    }
    write_motion(&generated.join("song9.npy"), &sway(400, 1.0));
    try_with("", 1, "song9 is no piece of");
    fs::remove_file(generated.join("song9.npy")).unwrap();
    let mut broken = sway(400, 1.0);
    broken[(5, 1, 2)] = f32::NAN;
    write_motion(&generated.join("song0.npy"), &broken);
    try_with("", 1, "song0.npy: frame 5, joint 1 is not finite");
    write_motion(&generated.join("song0.npy"), &sway(3, 1.0));
    try_with("", 1, "song0.npy: it has 3 frames");
}
