//! The command line as a user meets it: help, exit codes, one song to every format.

#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    unreachable_pub,
    reason = "helpers of tests: failing loudly is their job"
)]

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use bailando::model::{Manifest, ModelDirectory};
use ndarray::{Array2, Array3};

const SONG: &str = "tests/fixtures/audio/demo.ogg";
/// Eight seconds.
const WAV: &str = "tests/fixtures/audio/demo_44k1_8s.wav";

fn bailando(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bailando"));
    command
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(arguments)
        .env("COLUMNS", "100");
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("BAILANDO_") {
            command.env_remove(name);
        }
    }
    command.output().expect("the binary runs")
}

fn succeed(arguments: &[&str]) -> String {
    let output = bailando(arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// Exit code and standard error of a command that must not work.
fn fail(arguments: &[&str]) -> (Option<i32>, String) {
    let output = bailando(arguments);
    assert!(!output.status.success(), "{arguments:?} worked");
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

fn default_manifest() -> Manifest {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/default");
    let directory = ModelDirectory::open(&folder).expect("the default model");
    directory.manifest().clone()
}

fn path(folder: &Path, name: &str) -> (PathBuf, String) {
    let path = folder.join(name);
    let text = path.to_str().expect("UTF-8").to_owned();
    (path, text)
}

#[test]
fn help_is_the_reference() {
    insta::assert_snapshot!("help", succeed(&["--help"]));
    for command in [
        "serve",
        "generate",
        "features",
        "evaluate",
        "codebook",
        "bench",
        "healthcheck",
    ] {
        insta::assert_snapshot!(format!("help_{command}"), succeed(&[command, "--help"]));
    }
}

/// A bench of the shortest kind: every figure is there, none is judged.
#[test]
fn a_bench_measures_every_part() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| path(folder.path(), name);
    let ((_, json), (_, plot), (_, baseline)) =
        (file("b.json"), file("b.svg"), file("baseline.json"));
    let times = r#"{"stages": {"features_3840": 1000.0}, "code_s": {"1": 2000.0}}"#;
    std::fs::write(&baseline, times).expect("a file");
    let arguments = [
        "bench",
        WAV,
        "--threads",
        "1",
        "--repeats",
        "1",
        "--lengths",
        "3,6",
        "--callers",
        "2",
        "--batch-codes",
        "9",
        "--baseline",
        &baseline,
        "--json",
        &json,
        "--plot",
        &plot,
    ];
    let table = succeed(&arguments);
    assert!(table.contains("x faster than 1000.00 s"), "{table}");
    assert!(table.contains("x faster than 2000000.00"), "{table}");
    let text = std::fs::read_to_string(&json).expect("figures");
    let figures: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let positive = |place: &str| {
        let found = figures.pointer(place).and_then(serde_json::Value::as_f64);
        assert!(found.is_some_and(|value| value > 0.0), "{place}: {found:?}");
    };
    for place in [
        "/start_s",
        "/stages/0/seconds",
        "/steps/0/floor_s",
        "/steps/0/steps/4/seconds",
        "/steps/0/prime_s",
        "/steps/0/code_s",
        "/throughput/one_after_another_s",
        "/throughput/at_once_s",
        "/load/0/p95_s",
        "/lengths/1/elapsed_s",
    ] {
        positive(place);
    }
    assert_eq!(figures["throughput"]["same_codes"], true);
    // 46 rows of eight frames.
    assert_eq!(figures["lengths"][1]["frames"], 368);
    let svg = std::fs::read_to_string(&plot).expect("a plot");
    assert!(svg.contains("seconds of music"), "{svg}");
}

#[test]
fn wrong_use_exits_with_2_and_failure_with_1() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_, json) = path(folder.path(), "dance.json");
    let (_, glb) = path(folder.path(), "dance.glb");
    let (_, lost) = path(folder.path(), "no/such/folder/dance.json");
    let usage: [&[&str]; 13] = [
        &["bench", SONG, "--threads", "0"],
        &["bench", SONG, "--lengths", "-3"],
        &["codebook"],
        &["codebook", "-o", &lost, "--sort", "uses"],
        &["codebook", "-o", &lost, "--columns", "0"],
        &["generate", SONG, "-o", &lost],
        &["generate", SONG, "-o", &json, "--max-audio-seconds", "nan"],
        &[
            "generate",
            "--features",
            "f.npy",
            "--codes-out",
            "c.npy",
            "--fps",
            "30",
        ],
        &["dance"],
        &["generate", SONG],
        &["generate", SONG, "-o", &glb],
        &["generate", SONG, "-o", &json, "--fps", "25"],
        &["generate", SONG, SONG, "-o", &json],
    ];
    for arguments in usage {
        let (code, message) = fail(arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {message}");
    }
    let failures: [(&[&str], &str); 4] = [
        (
            &["generate", "no-such-song.mp3", "-o", &json],
            "no-such-song.mp3",
        ),
        (&["generate", "Cargo.toml", "-o", &json], "Cargo.toml"),
        (
            &["generate", SONG, "-o", &json, "--model-dir", "src"],
            "manifest.json",
        ),
        (
            &["healthcheck", "--url", "http://127.0.0.1:1/health"],
            "127.0.0.1:1",
        ),
    ];
    for (arguments, expected) in failures {
        let (code, message) = fail(arguments);
        assert_eq!(code, Some(1), "{arguments:?}: {message}");
        assert!(message.contains(expected), "{message}");
        assert_eq!(message.trim_end().lines().count(), 1, "one line: {message}");
    }
}

#[test]
fn a_song_becomes_json_bvh_and_npy_of_the_same_dance() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str| {
        let (path, text) = path(folder.path(), name);
        succeed(&[
            "generate",
            SONG,
            "-o",
            &text,
            "--seed",
            "7",
            "--duration-s",
            "6",
        ]);
        path
    };
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(write("a.json")).expect("json")).expect("JSON");
    let positions: Array3<f32> = ndarray_npy::read_npy(write("a.npy")).expect("npy");
    let bvh = std::fs::read_to_string(write("a.bvh")).expect("bvh");

    let frames = positions.dim().0;
    assert!(
        frames.abs_diff(360) <= 8,
        "6 s at 60 fps, not {frames} frames"
    );
    assert_eq!(json["frames"], frames);
    assert_eq!(json["seed"], 7);
    assert!(bvh.contains(&format!("Frames: {frames}")));
    let hand = json["positions"][frames - 1][23][1]
        .as_f64()
        .expect("a number");
    assert!((hand - f64::from(positions[[frames - 1, 23, 1]])).abs() < 1e-5);
}

#[test]
fn several_songs_go_to_a_folder_and_a_bad_one_does_not_stop_the_rest() {
    let folder = tempfile::tempdir().expect("a folder");
    let (out, out_text) = path(folder.path(), "dances");
    let (code, message) = fail(&[
        "generate",
        "Cargo.toml",
        SONG,
        "--out-dir",
        &out_text,
        "--format",
        "json",
        "--duration-s",
        "2",
        "--seed",
        "1",
    ]);
    assert_eq!(code, Some(1));
    assert!(message.contains("1 of 2 songs"), "{message}");
    assert!(out.join("demo.json").is_file());
}

#[test]
fn dots_in_a_songs_name_stay_in_the_dances_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let songs = ["01. B ft. C.ogg", "01. B ft. D.ogg"].map(|name| {
        let (copy, text) = path(folder.path(), name);
        let song = Path::new(env!("CARGO_MANIFEST_DIR")).join(SONG);
        std::fs::copy(song, copy).expect("copied");
        text
    });
    let (out, out_text) = path(folder.path(), "dances");
    succeed(&[
        "generate",
        &songs[0],
        &songs[1],
        "--out-dir",
        &out_text,
        "--duration-s",
        "1",
    ]);
    assert!(out.join("01. B ft. C.bvh").is_file());
    assert!(out.join("01. B ft. D.bvh").is_file());
}

#[test]
fn rows_that_declare_more_than_they_hold_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let (rows, rows_text) = path(folder.path(), "rows.npy");
    let (_, codes) = path(folder.path(), "codes.npy");
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000, 438), }\n";
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    std::fs::write(rows, bytes).expect("written");
    let (code, message) = fail(&["generate", "--features", &rows_text, "--codes-out", &codes]);
    assert_eq!(code, Some(1), "{message}");
    assert!(
        message.contains("rows.npy: not a matrix of float32"),
        "{message}"
    );
}

#[test]
fn features_and_rows_give_the_codes_of_the_song() {
    let folder = tempfile::tempdir().expect("a folder");
    let (rows_path, rows_text) = path(folder.path(), "rows.npy");
    let (codes_path, codes_text) = path(folder.path(), "codes.npy");
    let (positions_path, positions_text) = path(folder.path(), "positions.npy");
    let model = default_manifest();
    let [upper, lower] = model.start_codes[0].map(|code| code.to_string());
    let periods = model.features.count_periods.iter().map(u32::to_string);
    let periods = periods.collect::<Vec<_>>().join(",");
    let mut features = vec!["features", SONG, "-o", &rows_text];
    if !periods.is_empty() {
        features.extend(["--count-periods", &periods]);
    }
    succeed(&features);
    let rows: Array2<f32> = ndarray_npy::read_npy(rows_path).expect("npy");
    assert_eq!(rows.dim(), (226, model.features.columns));
    succeed(&[
        "generate",
        "--features",
        &rows_text,
        "--start-upper",
        &upper,
        "--start-lower",
        &lower,
        "--window",
        "hop",
        "--hop",
        "15",
        "--seed",
        "3",
        "--codes-out",
        &codes_text,
        "--positions-out",
        &positions_text,
    ]);
    let codes: Array2<i64> = ndarray_npy::read_npy(codes_path).expect("npy");
    let positions: Array3<f32> = ndarray_npy::read_npy(positions_path).expect("npy");
    assert_eq!(codes.dim(), (2, 226));
    let first = [codes[[0, 0]], codes[[1, 0]]];
    assert_eq!(first, model.start_codes[0].map(i64::from));
    assert_eq!(positions.dim(), (8 * 226, 24, 3));
    assert_eq!(
        positions[[0, 0, 1]],
        0.0,
        "raw positions begin at the origin"
    );

    let json = path(folder.path(), "song.json");
    succeed(&[
        "generate",
        SONG,
        "-o",
        &json.1,
        "--start-upper",
        &upper,
        "--start-lower",
        &lower,
        "--hop",
        "15",
        "--seed",
        "3",
        // Rows tell no beats to choose candidates by.
        "--candidates",
        "1",
    ]);
    let dance: serde_json::Value =
        serde_json::from_slice(&std::fs::read(json.0).expect("json")).expect("JSON");
    for (half, name) in ["upper", "lower"].iter().enumerate() {
        let from_song: Vec<i64> =
            serde_json::from_value(dance["codes"][name].clone()).expect("codes");
        assert_eq!(from_song, codes.row(half).to_vec());
    }
}

#[test]
fn a_codebook_is_drawn_with_the_uses_of_its_codes() {
    let folder = tempfile::tempdir().expect("a folder");
    let (codes, codes_text) = path(folder.path(), "codes.npy");
    let (out, out_text) = path(folder.path(), "book");
    let dance = Array2::from_shape_vec((2, 4), vec![7_i64, 7, 9, 9, 30, 30, 200, 7]);
    ndarray_npy::write_npy(&codes, &dance.expect("two rows")).expect("written");
    let arguments = ["codebook", "-o", &out_text, "--sort", "uses"];
    let arguments = [&arguments[..], &["--pairs", "3", "--codes", &codes_text]].concat();
    let said = succeed(&arguments);
    assert!(
        said.contains("256 upper and 256 lower codes, 2 changes"),
        "{said}"
    );

    let read = |name: &str| std::fs::read_to_string(out.join(name)).expect(name);
    let json: serde_json::Value = serde_json::from_str(&read("codebook.json")).expect("JSON");
    assert_eq!(json["upper"]["codes"][7]["uses"], 2);
    assert_eq!(json["lower"]["codes"][200]["uses"], 1);
    assert_eq!(json["transitions"][0]["from"], serde_json::json!([7, 30]));
    for name in ["upper.svg", "lower.svg", "pairs.svg"] {
        let svg = read(name);
        assert!(
            svg.starts_with("<svg ") && svg.contains(&default_manifest().name),
            "{name}"
        );
        assert!(read("index.html").contains(&svg), "{name}");
    }
    assert!(read("upper.svg").contains("\n7 (2×)\n"));

    let foreign = Array2::from_elem((2, 3), 256_i64);
    ndarray_npy::write_npy(&codes, &foreign).expect("written");
    let (code, message) = fail(&arguments);
    assert_eq!(code, Some(1), "{message}");
    assert!(message.contains("codes.npy: upper code 256"), "{message}");
}
