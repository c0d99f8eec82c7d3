//! The commands of docs/training.md on the sample data of the repository, as they stand there.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use bailando_testkit::project;

use crate::common::{stdout, train};

/// The block of the page that names the sample.
fn commands() -> Vec<String> {
    let page = fs::read_to_string(project("docs/training.md")).unwrap();
    let blocks = page.split("```").filter(|block| block.starts_with("sh"));
    let block = blocks.filter(|block| block.contains("tests/fixtures/sample")).last().unwrap();
    block.lines().skip(1).filter(|line| !line.is_empty()).map(str::to_owned).collect()
}

/// The service's program, which a build of the workspace puts beside the trainer's.
fn service() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_BIN_EXE_bailando-train")).with_file_name("bailando");
    if !path.is_file() {
        println!("skipped: needs bailando beside bailando-train");
    }
    path.is_file().then_some(path)
}

/// Runs a line of the page in `folder` and returns its standard output.
fn run(line: &str, service: &Path, folder: &Path) -> String {
    let (program, arguments) = line.split_once(' ').unwrap();
    let program = match program {
        "bailando-train" => Path::new(env!("CARGO_BIN_EXE_bailando-train")),
        _ => service,
    };
    let libraries = project(".onnxruntime/lib");
    let mut command = Command::new(program);
    if std::env::var_os("ORT_DYLIB_PATH").is_none() && libraries.is_dir() {
        command.env("ORT_DYLIB_PATH", libraries.join("libonnxruntime.so"));
    }
    let output = command
        .args(arguments.split(' '))
        .current_dir(folder)
        .env("XDG_CACHE_HOME", folder.join("cache"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{line}: {output:?}");
    stdout(&output)
}

#[cfg(unix)]
#[test]
fn the_commands_of_the_page_train_generate_and_evaluate() {
    let Some(service) = service() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    for name in ["train", "tests"] {
        std::os::unix::fs::symlink(project(name), folder.path().join(name)).unwrap();
    }
    let commands = commands();
    let [trained, generated, evaluated] = &commands[..] else {
        panic!("three commands: {commands:?}");
    };
    let report = run(trained, &service, folder.path());
    assert!(report.contains("export: wrote runs/tiny/model"), "{report}");
    run(generated, &service, folder.path());
    let dances = fs::read_dir(folder.path().join("generated")).unwrap().count();
    assert_eq!(dances, 4);
    let table = run(evaluated, &service, folder.path());
    assert!(table.contains("FID"), "{table}");

    // What `encode` writes, codes included, can be measured as it is.
    let encode = "bailando-train encode tests/fixtures/sample --model-dir runs/tiny/model --split \
                  train --reconstruct --out decoded";
    run(encode, &service, folder.path());
    let table = run(
        &evaluated.replace("generated generated", "generated decoded"),
        &service,
        folder.path(),
    );
    assert!(table.contains("FID"), "{table}");
}

#[test]
fn the_sample_is_usable() {
    let sample = project("tests/fixtures/sample");
    let output = train(&["check-data", sample.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
}
