//! The command line as a person meets it: help, exit codes, one-line errors.

use std::{path::Path, process::Output};

use crate::common::{self, fixture, stdout, train};

/// Imports the golden models into `out` with more arguments.
fn import(out: &Path, more: &[&str]) -> Output {
    let (vqvae, gpt) = (fixture("tiny_vqvae.pt"), fixture("tiny_gpt.pt"));
    import_from(&vqvae, &gpt, out, more)
}

fn import_from(vqvae: &Path, gpt: &Path, out: &Path, more: &[&str]) -> Output {
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let (vqvae, gpt, out) = (text(vqvae), text(gpt), text(out));
    let mut arguments = vec!["import", "--vqvae", &vqvae, "--gpt", &gpt, "--out", &out];
    arguments.extend(more);
    train(&arguments)
}

/// The one line of a failure, without the folder of the day.
#[track_caller]
fn failure(output: &Output, folder: &Path) -> String {
    let text = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(stdout(output).is_empty());
    let fixtures = fixture("");
    text.replace(folder.to_str().unwrap(), "DIR").replace(fixtures.to_str().unwrap(), "FIXTURES/")
}

#[test]
fn help() {
    let output = train(&["--help"]);
    assert_eq!(output.status.code(), Some(0));
    insta::assert_snapshot!("help", stdout(&output));
    let output = train(&["import", "--help"]);
    assert_eq!(output.status.code(), Some(0));
    insta::assert_snapshot!("help_import", stdout(&output));
    let output = train(&["run", "--help"]);
    assert_eq!(output.status.code(), Some(0));
    insta::assert_snapshot!("help_run", stdout(&output));
}

#[test]
fn wrong_usage_exits_with_2() {
    let import = ["import", "--vqvae", "a", "--gpt", "b", "--out", "c"];
    let wrong = [["--temperature", "-1"], ["--profile", "librosa-9"], ["--root-height", "nan"]];
    let imports = wrong.map(|wrong| [&import[..], &wrong].concat());
    let others = [&["dance"][..], &["import"], &["encode", "--out", "c"]].map(<[_]>::to_vec);
    for arguments in imports.iter().chain(&others) {
        assert_eq!(train(arguments).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn an_import_reports_and_is_not_overwritten_by_accident() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("model");
    let output = import(&out, &["--heads", "4", "--name", "tiny", "--licence", "MIT"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = stdout(&output).replace(folder.path().to_str().unwrap(), "DIR");
    assert!(report.starts_with("wrote DIR/model (tiny)\n"), "{report}");
    let again = import(&out, &["--heads", "4"]);
    assert_eq!(
        failure(&again, folder.path()),
        "error: DIR/model is already there: choose another directory, or replace the model in it \
         with --force\n"
    );
    assert_eq!(import(&out, &["--heads", "4", "--force"]).status.code(), Some(0));
}

#[test]
fn the_manifest_holds_what_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let starts = file("starts.json", r#"{"start_codes": [[8, 3], [0, 15]], "heads": 4}"#);
    let training = file("training.json", r#"{"steps": 2200, "data": "random numbers"}"#);
    let out = folder.path().join("model");
    let output = import(
        &out,
        &[
            "--heads",
            "4",
            "--profile",
            "librosa-0.11",
            "--temperature",
            "1",
            "--weights",
            "f16",
            "--name",
            "tiny",
            "--licence",
            "MIT",
            "--root-height",
            "0.9",
            "--start-codes",
            &starts,
            "--training",
            &training,
        ],
    );
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let text = std::fs::read_to_string(out.join("manifest.json")).unwrap();
    let mut manifest: serde_json::Value = serde_json::from_str(&text).unwrap();
    // The skeleton and the hashes have tests of their own.
    manifest["skeleton"].as_object_mut().unwrap().retain(|key, _| key == "root_height");
    manifest["files"].as_object_mut().unwrap().values_mut().for_each(|file| {
        *file = serde_json::Value::Null;
    });
    insta::with_settings!({sort_maps => true}, {
        insta::assert_json_snapshot!("manifest", manifest);
    });
}

#[test]
fn start_codes_default_to_none_where_the_official_pair_is_unknown() {
    let (_folder, directory) = common::imported(|_| {});
    assert!(directory.manifest().start_codes.is_empty());
}

#[test]
fn failures_are_one_line_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("model");
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let (vqvae, gpt) = (fixture("tiny_vqvae.pt"), fixture("tiny_gpt.pt"));
    let whole = std::fs::read(&gpt).unwrap();
    let cut = write("cut.pt", &whole[..whole.len() / 2]);
    let text = write("text.pt", b"these are not the weights you are looking for");
    let bad_json = write("bad.json", b"{\"start\": 1}");
    let outside = write("outside.json", b"[[423, 12]]");
    let flag = |path: &Path| path.to_str().unwrap().to_owned();
    let heads: &[&str] = &["--heads", "4"];
    let missing = folder.path().join("missing.pt");

    let outputs = [
        import_from(&missing, &gpt, &out, heads),
        import_from(&vqvae, &cut, &out, heads),
        import_from(&text, &gpt, &out, heads),
        import_from(&gpt, &vqvae, &out, heads),
        import(&out, &["--heads", "5"]),
        import(&out, &["--heads", "4", "--start-codes", &flag(&bad_json)]),
        import(&out, &["--heads", "4", "--start-codes", &flag(&outside)]),
        import(folder.path(), &["--heads", "4", "--force"]),
        import(&folder.path().join("text.pt/model"), heads),
    ];
    let lines: String = outputs.iter().map(|output| failure(output, folder.path())).collect();
    insta::assert_snapshot!("failures", lines);
    assert!(!out.exists());
    let left = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 4, "only the inputs are left");
}
