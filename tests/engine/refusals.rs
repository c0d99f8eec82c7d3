//! Models that the engine refuses, in one line.

use std::fs;

use bailando_testkit::{
    model::{changed, tiny, tiny_dancer},
    read_json,
};

use super::open;

/// A manifest that lies about its graphs, with hashes that fit, is found out at start.
#[test]
fn a_manifest_that_does_not_fit_its_graphs_is_refused_at_start() {
    let honest = read_json(&tiny().join("manifest.json"));
    let folder = changed(&tiny(), |_| {});
    let lies = [
        ("/vocabulary/upper", 32_u64),
        ("/vocabulary/lower", 8),
        ("/gpt/heads", 3),
        ("/gpt/layers", 3),
        ("/gpt/layers", 1_000_000_000),
        ("/gpt/block", u64::MAX),
        ("/gpt/context", 29),
        ("/gpt/channels", 96),
        ("/decoder/receptive_codes", 0),
        ("/decoder/receptive_codes", u64::MAX),
        ("/decoder/width", 0),
    ];
    for (place, value) in lies {
        let mut manifest = honest.clone();
        *manifest.pointer_mut(place).unwrap() = value.into();
        fs::write(folder.path().join("manifest.json"), manifest.to_string()).unwrap();
        let error = open(folder.path()).expect_err(place).to_string();
        assert!(!error.contains('\n'), "{place} {value}: {error}");
        println!("{place} = {value}: {error}");
    }
}

#[test]
fn a_manifest_with_the_wrong_frame_is_refused_at_start() {
    for (frame, problem) in
        [("world", "motion has 73 columns, expected 72"), ("moon", "unknown variant `moon`")]
    {
        let folder = changed(&tiny_dancer(), |manifest| manifest["motion_frame"] = frame.into());
        let error = open(folder.path()).unwrap_err().to_string();
        assert!(error.contains(problem), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
}
