//! The corpora of the fuzz targets on any compiler: every file, and mutations of them, through what
//! the targets call.

#![allow(
    clippy::unwrap_used,
    reason = "tests stop where something is not as it should be"
)]

use std::{fs, path::Path};

use bailando::{fuzzing, model::Manifest};
use bailando_testkit::corpus::Corpus;

fn corpus(target: &str) -> Corpus {
    Corpus::read(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus"),
        target,
    )
}

fn model() -> Manifest {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/default/manifest.json");
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn containers() {
    corpus("container").run(60, fuzzing::container);
}

#[test]
fn options() {
    let model = model();
    corpus("options").run(2_000, |bytes| fuzzing::options(bytes, &model));
}

#[test]
fn manifests() {
    corpus("manifest").run(1_000, fuzzing::manifest);
}

#[test]
fn graphs() {
    corpus("graph").run(5_000, fuzzing::graph);
}
