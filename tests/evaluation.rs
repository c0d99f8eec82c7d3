//! `bailando evaluate` as a user meets it.

#![expect(clippy::unwrap_used, reason = "a test says what is wrong by failing")]

use std::collections::BTreeMap;

use bailando_testkit::motion::{folders, sway, write_motion};

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
