//! `check-data` as a person meets it, and over the real folders.

use crate::testing;
use std::{
    path::Path,
    process::{Command, Output},
};

use crate::testing::TestFolder;
use bailando_testkit::shared;
use bailando_train::{
    data::{
        Dataset, OpenOptions,
        check::{CheckOptions, Report, Topic, check},
    },
    export::skeleton,
};
use serde_json::{Value, json};

fn check_data(folder: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bailando-train"))
        .arg("check-data")
        .arg(folder)
        .args(more)
        .env_remove("COLUMNS")
        .output()
        .unwrap()
}

/// Standard output and error without the folder of the day.
fn texts(output: &Output, folder: &Path) -> (String, String) {
    let text = |bytes: &[u8]| {
        let text = String::from_utf8(bytes.to_vec()).unwrap();
        text.replace(folder.to_str().unwrap(), "DIR")
    };
    (text(&output.stdout), text(&output.stderr))
}

#[test]
fn help() {
    let output = check_data(Path::new("--help"), &[]);
    assert_eq!(output.status.code(), Some(0));
    insta::assert_snapshot!("help_check_data", texts(&output, Path::new("DIR")).0);
}

#[test]
fn a_good_folder_is_usable() {
    let data = TestFolder::good(&skeleton(0.93));
    let folder = data.write();
    let output = check_data(folder, &[]);
    assert_eq!(output.status.code(), Some(0));
    let (report, errors) = texts(&output, folder);
    insta::assert_snapshot!("report_good", report);
    assert_eq!(errors, "");
}

#[test]
fn a_spoiled_folder_is_explained_and_exits_with_1() {
    let mut data = TestFolder::good(&skeleton(0.93));
    let centimetres = testing::dance(&skeleton(0.93), testing::FRAMES, 0) * 100.0;
    data.motion("one.npy", &centimetres);
    data.set("two_a", "audio", json!("nowhere.wav"));
    data.set("three_a", "split", json!("train"));
    let folder = data.write();
    let output = check_data(folder, &[]);
    assert_eq!(output.status.code(), Some(1));
    let (report, errors) = texts(&output, folder);
    insta::assert_snapshot!("report_spoiled", report);
    assert_eq!(errors, "error: DIR: not usable as it is: 2 problems, 1 warning\n");

    let output = check_data(folder, &["--json", "--songs", "0"]);
    assert_eq!(output.status.code(), Some(1));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let topics: Vec<&Value> =
        report["findings"].as_array().unwrap().iter().map(|finding| &finding["topic"]).collect();
    assert_eq!(topics, ["missing-file", "units", "no-test"]);
    assert_eq!(report["splits"][0]["pieces"], 4);
}

#[test]
fn a_folder_without_data_is_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let output = check_data(folder.path(), &[]);
    assert_eq!(output.status.code(), Some(1));
    let (report, errors) = texts(&output, folder.path());
    assert_eq!(report, "");
    assert!(errors.starts_with("error: DIR: no training data here"), "{errors}");
    assert_eq!(errors.lines().count(), 1);
}

fn report(folder: &Path, songs: usize) -> Report {
    let options = CheckOptions { songs: Some(songs), beats: songs, ..CheckOptions::default() };
    check(folder, &options).unwrap()
}

fn topics(report: &Report) -> Vec<Topic> {
    report.findings.iter().map(|finding| finding.topic).collect()
}

#[test]
fn the_salsa_set_is_as_its_description_says() {
    let Some(folder) = shared("data/salsa") else {
        return;
    };
    let report = report(&folder, 3);
    assert!(report.findings.is_empty(), "{report}");
    let counts: Vec<_> =
        report.splits.iter().map(|split| (split.pieces, split.dances, split.songs)).collect();
    assert_eq!(counts, [(198, 44, 128), (42, 6, 21)]);
    let minutes: Vec<String> = report
        .splits
        .iter()
        .map(|split| format!("{:.1} {:.1}", split.minutes, split.dance_minutes))
        .collect();
    assert_eq!(minutes, ["100.1 22.3", "19.5 2.8"]);
    let data = Dataset::open(&folder, &OpenOptions::default()).unwrap();
    assert_eq!(data.training().unwrap().recordings().len(), 44);
    assert_eq!(data.evaluation().unwrap().recordings().len(), 6);
}

#[test]
fn the_ballroom_sample_and_the_motion_without_music_are_usable() {
    let Some(folder) = shared("data/dance-with-melody-sample") else {
        return;
    };
    let sample = report(&folder, 2);
    assert!(sample.findings.is_empty(), "{sample}");
    let folder = shared("data/extra-motion").unwrap();
    let motion = report(&folder, 0);
    assert_eq!(topics(&motion), [Topic::NoTest, Topic::NoMusic, Topic::Layout]);
    assert_eq!(motion.splits[0].dances, 33);
}
