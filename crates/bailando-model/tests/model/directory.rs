//! Manifests as they are read and written, and directories that do not fit theirs.

use std::fs;

use bailando_model::{Manifest, ModelDirectory};
use bailando_motion::MotionFrame;
use bailando_testkit::model::{changed, tiny, tiny_dancer};

use crate::golden;

/// Manifests from before there was a choice of frame, counts or candidates, and their hashes, stay
/// what they are.
#[test]
fn manifests_are_unchanged_by_reading_and_writing() {
    let first = golden("manifest_of_the_first_model.json");
    let [tiny, dancer] = [tiny(), tiny_dancer()].map(|model| model.join("manifest.json"));
    let [first, tiny, dancer] = [first, tiny, dancer].map(|path| {
        let text = fs::read_to_string(path).unwrap();
        let manifest: Manifest = serde_json::from_str(&text).unwrap();
        assert_eq!(serde_json::to_string_pretty(&manifest).unwrap() + "\n", text);
        (manifest, text)
    });
    for (manifest, text) in [first, tiny] {
        assert_eq!(manifest.motion_frame, MotionFrame::World);
        assert!(!text.contains("motion_frame"));
        assert_eq!(manifest.decoded_columns(), 72);
        assert_eq!((manifest.sampling.guidance, manifest.sampling.candidates), (1.0, 1));
    }
    assert_eq!(dancer.0.motion_frame, MotionFrame::Dancer);
    assert!(dancer.1.contains("\"motion_frame\": \"dancer\""));
    assert_eq!(dancer.0.decoded_columns(), 73);
}

#[test]
fn a_directory_that_does_not_fit_its_manifest_is_refused_in_one_line() {
    let folder = changed(&tiny(), |_| {});
    let refused = |expected: &str| {
        let error = ModelDirectory::open(folder.path()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert!(!error.contains('\n'), "{error}");
    };
    let decoder = folder.path().join("decoder.onnx");
    let bytes = fs::read(&decoder).unwrap();
    fs::write(&decoder, &bytes[..bytes.len() / 2]).unwrap();
    refused("decoder.onnx: the size in bytes is");
    let mut changed = bytes.clone();
    changed[bytes.len() / 2] ^= 1;
    fs::write(&decoder, &changed).unwrap();
    refused("decoder.onnx: the SHA-256 is");
    fs::remove_file(&decoder).unwrap();
    refused("decoder.onnx");
    fs::write(&decoder, &bytes).unwrap();

    let manifest = folder.path().join("manifest.json");
    let text = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, text.replace("\"decoder.onnx\"", "\"../decoder.onnx\"")).unwrap();
    refused("manifest.json");
    fs::write(&manifest, "{}").unwrap();
    refused("manifest.json");
}
