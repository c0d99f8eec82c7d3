//! The corpora of the fuzz targets on any compiler: every file and mutations of it, through the
//! functions that the targets call.

use bailando::{audio, fuzzing, model};
use bailando_testkit::{corpus::Corpus, model::tiny_dancer, project};

fn corpus(target: &str) -> Corpus {
    Corpus::read(&project("fuzz/corpus"), target)
}

#[test]
fn containers() {
    corpus("container").run(60, audio::fuzzing::container);
}

#[test]
fn options() {
    let manifest = std::fs::read(tiny_dancer().join("manifest.json")).unwrap();
    let manifest = serde_json::from_slice(&manifest).unwrap();
    corpus("options").run(2_000, |bytes| fuzzing::options(bytes, &manifest));
}

#[test]
fn manifests() {
    corpus("manifest").run(1_000, fuzzing::manifest);
}

#[test]
fn rigs() {
    corpus("rig").run(1_000, fuzzing::rig);
}

#[test]
fn graphs() {
    corpus("graph").run(5_000, model::graph_is_accepted);
}
