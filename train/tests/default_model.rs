//! The model that ships: whole, loadable, documented and small enough.

#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests: failing loudly is their job"
)]

use std::{fs, path::Path};

use bailando::{CancelToken, model::ModelDirectory};

/// What a clone may weigh for the sake of its first dance.
const LIMIT_BYTES: u64 = 40_000_000;

#[test]
fn the_default_model_is_whole() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/default");
    let directory = ModelDirectory::open(&folder).unwrap();
    directory.gpt(1).unwrap();
    directory.encoder(1).unwrap();
    let mut decoder = directory.decoder(1).unwrap();
    let [upper, lower] = directory.manifest().start_codes[0];
    let motion = decoder
        .decode(&[upper], &[lower], &CancelToken::new())
        .unwrap();
    assert_eq!(motion.dim(), (8, 72));
    // Joints are relative to the root: none is further away than a body is tall.
    assert!(motion.iter().all(|value| value.abs() < 2.0));

    let entries = fs::read_dir(&folder).unwrap();
    let bytes: u64 = entries
        .map(|entry| entry.unwrap().metadata().unwrap().len())
        .sum();
    assert!(bytes <= LIMIT_BYTES, "{bytes} bytes");
    let card = fs::read_to_string(folder.join("MODEL_CARD.md")).unwrap();
    assert!(card.contains(&directory.manifest().name));
    assert!(
        card.contains("mocap.cs.cmu.edu"),
        "the data's owner is not acknowledged"
    );
}
