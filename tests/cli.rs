//! The command line as a user meets it: help, exit codes, one song to every format.

use std::{fs, path::Path, process::Command};

use bailando::model::{Manifest, ModelDirectory};
use bailando_testkit::{model::tiny_dancer, project};
use ndarray::{Array2, Array3};
use tempfile::TempDir;

pub(crate) const SONG: &str = "tests/fixtures/audio/demo.ogg";
/// Eight seconds.
const WAV: &str = "tests/fixtures/audio/demo_44k1_8s.wav";

/// A command in a folder, without the settings of the environment.
fn bailando(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bailando"));
    command.current_dir(folder).args(arguments).env("COLUMNS", "100");
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("BAILANDO_") {
            command.env_remove(name);
        }
    }
    command
}

/// Standard output and standard error of a command that must work.
fn succeeds(mut command: Command) -> (String, String) {
    let output = command.output().expect("the binary runs");
    let errors = String::from_utf8(output.stderr).expect("UTF-8");
    assert!(output.status.success(), "{command:?}: {errors}");
    (String::from_utf8(output.stdout).expect("UTF-8"), errors)
}

/// A command in the project's folder with the tiny model, the arguments separated by spaces.
pub(crate) fn in_project(arguments: &str) -> Command {
    let arguments: Vec<&str> = arguments.split_whitespace().collect();
    let mut command = bailando(&project(""), &arguments);
    command.env("BAILANDO_MODEL_DIR", tiny_dancer());
    command
}

pub(crate) fn succeed(arguments: &str) -> String {
    succeeds(in_project(arguments)).0
}

/// Exit code and standard error of a command that must not work.
pub(crate) fn fail(arguments: &str) -> (Option<i32>, String) {
    let output = in_project(arguments).output().expect("the binary runs");
    assert!(!output.status.success(), "{arguments} worked");
    let errors = String::from_utf8(output.stderr).expect("UTF-8");
    (output.status.code(), errors)
}

fn manifest() -> Manifest {
    let directory = ModelDirectory::open(&tiny_dancer()).expect("the tiny model");
    directory.manifest().clone()
}

pub(crate) fn folder() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

pub(crate) fn path(folder: &TempDir, name: &str) -> String {
    let path = folder.path().join(name);
    path.to_str().expect("UTF-8").to_owned()
}

pub(crate) fn json(path: &str) -> serde_json::Value {
    let text = fs::read(path).expect("a file");
    serde_json::from_slice(&text).expect("JSON")
}

fn npy<T: ndarray_npy::ReadNpyExt>(path: &str) -> T {
    ndarray_npy::read_npy(path).expect("npy")
}

#[test]
fn help_is_the_reference() {
    let help = |arguments: &[&str]| succeeds(bailando(&project(""), arguments)).0;
    insta::assert_snapshot!("help", help(&["--help"]));
    for command in [
        "serve",
        "generate",
        "batch",
        "features",
        "evaluate",
        "render",
        "codebook",
        "bench",
        "healthcheck",
    ] {
        insta::assert_snapshot!(format!("help_{command}"), help(&[command, "--help"]));
    }
}

/// What failed is reported and tried again; what is there is not made twice.
#[test]
fn a_batch_makes_what_is_missing_and_says_what_failed() {
    let folder = folder();
    let songs = folder.path().join("songs/below");
    fs::create_dir_all(&songs).expect("a folder");
    fs::copy(project(WAV), songs.join("good.wav")).expect("a song");
    fs::write(songs.join("bad.wav"), "no song").expect("a file");
    let [songs, out] = ["songs", "out"].map(|name| path(&folder, name));
    let batch = format!("batch {songs} --out-dir {out} --duration-s 2 --seed 1");
    let (code, errors) = fail(&batch);
    assert_eq!(code, Some(1), "{errors}");
    assert!(errors.contains("bad.wav") && errors.contains("1 of 2 songs failed"), "{errors}");
    let report = json(&format!("{out}/report.json"));
    assert_eq!(report["made"].as_array().map(Vec::len), Some(1), "{report}");
    let why = report["failed"][0]["error"].as_str().unwrap_or_default();
    assert!(!why.is_empty() && !why.contains("bad.wav"), "{report}");
    let made = fs::read(format!("{out}/below/good.bvh")).expect("a dance");
    assert!(made.starts_with(b"HIERARCHY"));
    assert!(!Path::new(&format!("{out}/below/bad.bvh.part")).exists());
    fs::remove_file(format!("{songs}/below/bad.wav")).expect("it is there");
    succeed(&batch);
    let report = json(&format!("{out}/report.json"));
    assert_eq!(report["there"].as_array().map(Vec::len), Some(1), "{report}");
    assert_eq!(report["made_otherwise"], serde_json::json!([]), "{report}");
    // Other options: the dance is kept, and that is said.
    let other = format!("{batch} --fps 30");
    let (_, said) = succeeds(in_project(&other));
    assert!(said.contains("made with other options: 1; --again"), "{said}");
    let report = json(&format!("{out}/report.json"));
    assert_eq!(report["made_otherwise"].as_array().map(Vec::len), Some(1), "{report}");
    assert_eq!(fs::read(format!("{out}/below/good.bvh")).expect("a dance"), made);
    let (_, said) = succeeds(in_project(&format!("{other} --again")));
    assert!(!said.contains("other options"), "{said}");
    let (_, said) = succeeds(in_project(&other));
    assert!(!said.contains("other options"), "{said}");
    let nobody = format!("{batch} --server ftp://nobody");
    assert_eq!(fail(&nobody).0, Some(2));
}

/// A bench of the shortest kind: every figure is there, none is judged.
#[test]
fn a_bench_measures_every_part() {
    let folder = folder();
    let [figures, plot, baseline] = ["b.json", "b.svg", "base.json"].map(|n| path(&folder, n));
    let times = r#"{"stages": {"features_3840": 1000.0}, "code_s": {"1": 2000.0}}"#;
    fs::write(&baseline, times).expect("a file");
    let table = succeed(&format!(
        "bench {WAV} --threads 1 --repeats 1 --lengths 3,6 --callers 2 --batch-codes 9 \
         --baseline {baseline} --json {figures} --plot {plot}"
    ));
    assert!(table.contains("x faster than 1000.00 s"), "{table}");
    assert!(table.contains("x faster than 2000000.00"), "{table}");
    let figures = json(&figures);
    for place in [
        "/start_s",
        "/stages/0/seconds",
        "/steps/0/floor_s",
        "/steps/0/steps/4/seconds",
        "/steps/0/prefill_s",
        "/steps/0/code_s",
        "/throughput/one_after_another_s",
        "/throughput/at_once_s",
        "/load/0/p95_s",
        "/lengths/1/elapsed_s",
    ] {
        let found = figures.pointer(place).and_then(serde_json::Value::as_f64);
        assert!(found.is_some_and(|value| value > 0.0), "{place}: {found:?}");
    }
    assert_eq!(figures["throughput"]["same_codes"], true);
    // Six seconds.
    assert_eq!(figures["lengths"][1]["frames"], 360);
    let svg = fs::read_to_string(&plot).expect("a plot");
    assert!(svg.contains("seconds of music"), "{svg}");
}

#[test]
fn wrong_use_exits_with_2_and_failure_with_1() {
    let folder = folder();
    let [json, movie] = ["dance.json", "dance.mp4"].map(|name| path(&folder, name));
    let lost = path(&folder, "no/such/folder/dance.json");
    for arguments in [
        "codebook",
        &format!("bench {SONG} --threads 0"),
        &format!("bench {SONG} --lengths -3"),
        &format!("codebook -o {lost} --sort uses"),
        &format!("codebook -o {lost} --columns 0"),
        &format!("features {SONG} -o {json} --rate 30720 --count-periods 4"),
        &format!("features {SONG} -o {json} --model-dir models/default --rate 3840"),
        &format!("generate {SONG} -o {lost}"),
        &format!("generate {SONG} -o {json} --max-audio-seconds nan"),
        "generate --features f.npy --codes-out c.npy --fps 30",
        "dance",
        &format!("generate {SONG}"),
        &format!("generate {SONG} -o {movie}"),
        &format!("generate {SONG} -o {json} --fps 25"),
        &format!("generate {SONG} -o {json} --device gpu"),
        &format!("generate {SONG} {SONG} -o {json}"),
    ] {
        let (code, message) = fail(arguments);
        assert_eq!(code, Some(2), "{arguments}: {message}");
    }
    let no_model = format!("generate {SONG} -o {json} --model-dir src");
    // Whatever the library, and however many GPUs there are.
    let no_device = format!("generate {SONG} -o {json} --device cuda:65535");
    let unreachable = "healthcheck --url http://127.0.0.1:1/health";
    for (arguments, expected) in [
        (&*format!("generate no-such-song.mp3 -o {json}"), "no-such-song.mp3"),
        (&format!("generate Cargo.toml -o {json}"), "Cargo.toml"),
        ("serve --data-dir /proc/nothing", "/proc/nothing"),
        ("evaluate --generated no-such-folder --reference no-such-folder", "no-such-folder"),
        (&no_model, "manifest.json"),
        (&no_device, "cuda:65535: "),
        (unreachable, "127.0.0.1:1"),
    ] {
        let (code, message) = fail(arguments);
        assert_eq!(code, Some(1), "{arguments}: {message}");
        assert!(message.contains(expected), "{message}");
        assert_eq!(message.trim_end().lines().count(), 1, "one line: {message}");
        let mut parts: Vec<&str> = message.trim_end().split(": ").collect();
        let said = parts.len();
        parts.sort_unstable();
        parts.dedup();
        assert_eq!(parts.len(), said, "said twice: {message}");
    }
}

#[test]
fn a_song_becomes_a_file_of_every_format() {
    let folder = folder();
    let [document, positions, bvh] = ["a.json", "a.npy", "a.bvh"].map(|name| {
        let path = path(&folder, name);
        succeed(&format!("generate {SONG} -o {path} --seed 7 --duration-s 6"));
        path
    });
    let json = json(&document);
    let positions: Array3<f32> = npy(&positions);
    let bvh = fs::read_to_string(bvh).expect("bvh");

    let frames = positions.dim().0;
    let close = frames.abs_diff(360) <= 8;
    assert!(close, "6 s at 60 fps, not {frames} frames");
    assert_eq!(json["frames"], frames);
    assert_eq!(json["seed"], 7);
    assert!(bvh.contains(&format!("Frames: {frames}")));
    for format in ["glb", "vrma", "fbx", "vmd", "npz"] {
        let file = path(&folder, &format!("a.{format}"));
        succeed(&format!("generate {SONG} -o {file} --seed 7 --duration-s 2"));
        let bytes = fs::read(&file).expect(format);
        let starts: &[u8] = match format {
            "fbx" => b"Kaydara FBX Binary",
            "vmd" => b"Vocaloid Motion Data 0002",
            "npz" => b"PK",
            _ => b"glTF",
        };
        assert!(bytes.starts_with(starts), "{format}");
    }
    let hand = json["positions"][frames - 1][23][1].as_f64();
    let expected = f64::from(positions[[frames - 1, 23, 1]]);
    assert!((hand.expect("a number") - expected).abs() < 1e-5);
}

#[test]
fn the_codes_of_a_dance_are_danced_without_its_song() {
    let folder = folder();
    let [first, again, pairs, bvh] =
        ["a.json", "b.json", "c.json", "d.bvh"].map(|name| path(&folder, name));
    succeed(&format!("generate {SONG} -o {first} --seed 7 --duration-s 4"));
    succeed(&format!("generate --codes {first} -o {again} --seed 7 --duration-s 4"));
    let (danced, again) = (json(&first), json(&again));
    for key in ["frames", "seed", "codes", "positions"] {
        assert!(danced[key] == again[key], "{key}");
    }
    fs::write(&pairs, "[[1, 2], [1, 2], [3, 4]]").expect("written");
    succeed(&format!("generate --codes {pairs} -o {bvh}"));
    assert!(fs::read_to_string(&bvh).expect("a file").contains("Frames: 24\n"));
    fs::write(&pairs, "[1, 2]").expect("written");
    let (code, said) = fail(&format!("generate --codes {pairs} -o {bvh}"));
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("c.json: expected JSON of pose codes"), "{said}");
    let (code, said) = fail(&format!("generate --codes {first} -o {bvh} --top-k 3"));
    assert!(code == Some(2) && said.contains("option `top_k`"), "{said}");
}

#[test]
fn several_songs_go_to_a_folder_and_a_bad_one_does_not_stop_the_rest() {
    let folder = folder();
    let out = path(&folder, "dances");
    let (code, message) = fail(&format!(
        "generate Cargo.toml {SONG} --out-dir {out} --format json --duration-s 2 --seed 1"
    ));
    assert_eq!(code, Some(1));
    assert!(message.contains("1 of 2 songs"), "{message}");
    assert!(Path::new(&out).join("demo.json").is_file());
}

#[test]
fn pipes_folders_in_folders_and_contradictions() {
    let folder = folder();
    let song = fs::read(project(WAV)).expect("the song");
    let mut piped = in_project("generate - -o - --format bvh --seed 3 -q");
    piped.stdin(fs::File::open(project(WAV)).expect("the song"));
    let (dance, said) = succeeds(piped);
    assert!(dance.starts_with("HIERARCHY") && said.is_empty(), "{said}");
    for name in [
        "songs/a.wav",
        "songs/deep/er/a.wav",
        "songs/deep/a.wav",
        "songs/deep/b.mp3",
        "songs/c.mkv",
        "songs/d.3gp",
        "songs/cover.jpg",
        "songs/deep/notes.txt",
    ] {
        let file = folder.path().join(name);
        fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
        fs::write(file, &song).expect("a song");
    }
    let (songs, out) = (path(&folder, "songs"), path(&folder, "out"));
    let all = format!("generate {songs} --out-dir {out} --recursive --format npy");
    let (_, said) = succeeds(in_project(&all));
    assert!(said.contains("songs: files of other kinds skipped: 2"), "{said}");
    for name in ["c.npy", "d.npy", "a.npy", "deep/a.npy", "deep/b.npy", "deep/er/a.npy"] {
        assert!(folder.path().join("out").join(name).is_file(), "{name}");
    }
    // Two songs of one name: the second one is named, the third is danced to.
    let all = format!("{songs}/a.wav {songs}/deep/a.wav {songs}/deep/b.mp3");
    let (code, said) = fail(&format!("generate {all} --out-dir {out}/flat"));
    assert_eq!(code, Some(1));
    assert!(said.contains("deep/a.wav: its result would replace that of"), "{said}");
    assert!(said.contains("1 of 3 songs"), "{said}");
    assert!(
        ["a.bvh", "b.bvh"].iter().all(|name| folder.path().join("out/flat").join(name).is_file())
    );
    for (arguments, wanted) in [
        ("generate - -o -", "needs --format"),
        ("generate - -o x.bvh --format json", "--format says json"),
        ("generate - -o x.bvh --offset-s -1", "expected a number from 0"),
        ("generate - -o x.bvh --max-audio-seconds -1", "expected seconds above 0"),
        ("features - -o f.csv", "NumPy files, .npy"),
    ] {
        let (code, said) = fail(arguments);
        assert!(code == Some(2) && said.contains(wanted), "{arguments}: {said}");
    }
    assert!(succeed("completions bash").contains("_bailando()"));
}

#[test]
fn dots_in_a_songs_name_stay_in_the_dances_name() {
    let folder = folder();
    let names = ["01. B ft. C", "01. B ft. D"];
    let songs = names.map(|name| path(&folder, &format!("{name}.ogg")));
    for song in &songs {
        fs::copy(project(SONG), song).expect("copied");
    }
    let arguments = ["generate", &songs[0], &songs[1], "--out-dir", "out", "--duration-s", "1"];
    let model = tiny_dancer();
    let model = ["--model-dir", model.to_str().expect("UTF-8")];
    succeeds(bailando(folder.path(), &[&arguments[..], &model].concat()));
    for name in names {
        assert!(folder.path().join(format!("out/{name}.bvh")).is_file());
    }
}

#[test]
fn rows_that_declare_more_than_they_hold_are_refused() {
    let folder = folder();
    let [rows, codes] = ["rows.npy", "codes.npy"].map(|name| path(&folder, name));
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000, 438), }\n";
    let length = (header.len() as u16).to_le_bytes();
    let bytes = [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes()].concat();
    fs::write(&rows, bytes).expect("written");
    let (code, message) = fail(&format!("generate --features {rows} --codes-out {codes}"));
    assert_eq!(code, Some(1), "{message}");
    let expected = "rows.npy: not a matrix of float32";
    assert!(message.contains(expected), "{message}");
}

#[test]
fn features_and_rows_give_the_codes_of_the_song() {
    let folder = folder();
    let [rows, codes, positions, song] =
        ["rows.npy", "codes.npy", "positions.npy", "song.json"].map(|name| path(&folder, name));
    let model = manifest();
    let [upper, lower] = model.start_codes[0];
    succeed(&format!("features {SONG} -o {rows} --model-dir {}", tiny_dancer().display()));
    let features: Array2<f32> = npy(&rows);
    assert_eq!(features.dim(), (226, model.features.columns));
    let periods = model.features.count_periods.iter().map(u32::to_string);
    let periods = periods.collect::<Vec<_>>().join(",");
    if !periods.is_empty() {
        succeed(&format!("features {SONG} -o {rows} --count-periods {periods}"));
        assert_eq!(features, npy::<Array2<f32>>(&rows));
    }
    let start = format!("--start-upper {upper} --start-lower {lower} --hop 15 --seed 3");
    succeed(&format!(
        "generate --features {rows} {start} --window hop --codes-out {codes} \
         --positions-out {positions}"
    ));
    let codes: Array2<i64> = npy(&codes);
    let positions: Array3<f32> = npy(&positions);
    assert_eq!(codes.dim(), (2, 226));
    let first = [codes[[0, 0]], codes[[1, 0]]];
    assert_eq!(first, model.start_codes[0].map(i64::from));
    assert_eq!(positions.dim(), (8 * 226, 24, 3));
    let origin = positions[[0, 0, 1]];
    assert_eq!(origin, 0.0, "raw positions begin at the origin");

    // Rows have no beats to choose candidates by.
    succeed(&format!("generate {SONG} -o {song} {start} --candidates 1"));
    let dance = json(&song);
    for (half, name) in ["upper", "lower"].into_iter().enumerate() {
        let from_song: Vec<i64> =
            serde_json::from_value(dance["codes"][name].clone()).expect("codes");
        assert_eq!(from_song, codes.row(half).to_vec());
    }
}

/// The two commands as README.md has them, run in a folder with a song and the models.
#[cfg(unix)]
#[test]
fn the_documented_way_over_feature_rows_works_as_written() {
    const FEATURES: &str = "bailando features song.mp3 -o features.npy --model-dir models/default";
    const GENERATE: &str = "bailando generate --features features.npy --codes-out codes.npy \
        --positions-out positions.npy";
    let folder = folder();
    fs::copy(project("tests/fixtures/audio/demo.mp3"), folder.path().join("song.mp3"))
        .expect("copied");
    let models = folder.path().join("models");
    fs::create_dir(&models).expect("created");
    std::os::unix::fs::symlink(tiny_dancer(), models.join("default")).expect("linked");
    let readme = fs::read_to_string(project("README.md")).expect("a README");
    let run = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().skip(1).collect();
        succeeds(bailando(folder.path(), &words)).1
    };
    for line in [FEATURES, GENERATE] {
        assert!(readme.contains(line), "README.md lacks: {line}");
        let errors = run(line);
        assert!(!errors.contains("warning: features.npy"), "{errors}");
    }
    let codes: Array2<i64> = npy(&path(&folder, "codes.npy"));
    let (rows, model) = (codes.ncols(), manifest());

    // Without the model's columns there is a dance too, with a word about the better way.
    run("bailando features song.mp3 -o features.npy");
    assert_eq!(npy::<Array2<f32>>(&path(&folder, "features.npy")).dim(), (rows, 438));
    let errors = run(GENERATE);
    let counts = !model.features.count_periods.is_empty();
    assert_eq!(errors.contains("--model-dir models/default"), counts, "{errors}");
    assert_eq!(npy::<Array2<i64>>(&path(&folder, "codes.npy")).dim(), (2, rows));
}

#[test]
fn what_a_film_lacks_is_said_in_one_line() {
    let folder = folder();
    let [dance, bare, film] = ["a.json", "b.json", "c.mp4"].map(|name| path(&folder, name));
    let picture = path(&folder, "c.png");
    succeed(&format!("generate {SONG} -o {dance} --duration-s 1 --include-rotations"));
    succeed(&format!("generate {SONG} -o {bare} --duration-s 1"));
    for (arguments, wanted) in [
        (&*format!("{bare} -o {film}"), "make it with `--include-rotations`"),
        (&format!("{WAV} -o {film}"), "this is no dance as JSON"),
        (&format!("{dance} -o {bare}"), "mp4, gif or png"),
        (&format!("{dance} -o {picture} --audio {SONG}"), "only mp4 has sound"),
        (&format!("{dance} -o {picture} --start-s 2"), "the dance ends at 1.0 s"),
        (&format!("{dance} -o {picture} --size 9x9"), "even numbers from 64 to 3840"),
        (&format!("{dance} -o {film} --chromium ./no-browser"), "no-browser: it cannot be started"),
        // A browser that answers; ffmpeg is looked for before it is opened.
        (&format!("{dance} -o {film} --chromium true --ffmpeg ./none"), "films need ffmpeg"),
    ] {
        let (code, said) = fail(&format!("render {arguments}"));
        assert!(matches!(code, Some(1 | 2)) && said.contains(wanted), "{arguments}: {said}");
    }
    // The song is laid under the film from where the dance was made to.
    #[cfg(unix)]
    for (given, wanted) in [("", "-ss 3.5 "), ("--audio-offset-s 1", "-ss 1.5 ")] {
        use std::os::unix::fs::PermissionsExt;
        let [encoder, told] = ["encoder", "told"].map(|name| path(&folder, name));
        fs::write(&encoder, format!("#!/bin/sh\necho \"$@\" >{told}\n")).expect("a script");
        fs::set_permissions(&encoder, fs::Permissions::from_mode(0o755)).expect("a program");
        let made = "--offset-s 3 --duration-s 1 --include-rotations";
        succeed(&format!("generate {SONG} -o {dance} {made}"));
        fail(&format!(
            "render {dance} -o {film} --chromium true --ffmpeg {encoder} --audio {SONG} \
             --start-s 0.5 {given}"
        ));
        let told = fs::read_to_string(&told).expect("ffmpeg was called");
        assert!(told.contains(wanted), "{told}");
    }
    // A browser that ends without a picture says so, at once.
    let (code, said) = fail(&format!("render {dance} -o {picture} --chromium true"));
    assert!(code == Some(1) && said.contains("true: the browser ended with exit"), "{said}");
}

#[test]
fn a_codebook_is_drawn_with_the_uses_of_its_codes() {
    let folder = folder();
    let [codes, out] = ["codes.npy", "book"].map(|name| path(&folder, name));
    let dance = ndarray::array![[7_i64, 7, 9, 9], [3, 3, 12, 7]];
    ndarray_npy::write_npy(&codes, &dance).expect("written");
    let arguments = format!("codebook -o {out} --sort uses --pairs 3 --codes {codes}");
    let said = succeed(&arguments);
    let counted = "16 upper and 16 lower codes, 2 changes";
    assert!(said.contains(counted), "{said}");

    let read = |name: &str| fs::read_to_string(format!("{out}/{name}")).expect(name);
    let json = json(&format!("{out}/codebook.json"));
    assert_eq!(json["upper"]["codes"][7]["uses"], 2);
    assert_eq!(json["lower"]["codes"][12]["uses"], 1);
    let memory = self::json(&format!("{out}/memory.json"));
    assert_eq!(memory["upper"][7]["next"], serde_json::json!([[9, 1]]));
    assert_eq!(memory["motions"], 1);
    assert_eq!(json["transitions"][0]["from"], serde_json::json!([7, 3]));
    for name in ["upper.svg", "lower.svg", "pairs.svg"] {
        let svg = read(name);
        let named = svg.contains(&manifest().name);
        assert!(svg.starts_with("<svg ") && named, "{name}");
        assert!(read("index.html").contains(&svg), "{name}");
    }
    assert!(read("upper.svg").contains("\n7 (2×)\n"));

    let foreign = Array2::from_elem((2, 3), 16_i64);
    ndarray_npy::write_npy(&codes, &foreign).expect("written");
    let (code, message) = fail(&arguments);
    assert_eq!(code, Some(1), "{message}");
    assert!(message.contains("codes.npy: upper code 16"), "{message}");
}
