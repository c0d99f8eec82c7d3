//! The model that ships: whole, loadable, documented and small enough.

use std::fs;

use bailando::model::{Manifest, ModelDirectory};
use bailando_testkit::project;

/// What a clone may weigh for the sake of its first dance.
const LIMIT_BYTES: u64 = 40_000_000;

#[test]
fn the_default_model_is_whole() {
    let folder = project("models/default");
    let directory = ModelDirectory::open(&folder).unwrap();
    directory.gpt(1).unwrap();
    directory.encoder(1).unwrap();
    let mut decoder = directory.decoder(1).unwrap();
    let start = &directory.manifest().start_codes[..1];
    let motion = decoder.decode(start).unwrap();
    assert_eq!(motion.dim(), (8, directory.manifest().decoded_columns()));
    // Joints are relative to the root: none is further away than a body is tall.
    assert!(motion.iter().all(|value| value.abs() < 2.0));

    let entries = fs::read_dir(&folder).unwrap();
    let bytes: u64 = entries.map(|entry| entry.unwrap().metadata().unwrap().len()).sum();
    assert!(bytes <= LIMIT_BYTES, "{bytes} bytes");
    let card = fs::read_to_string(folder.join("MODEL_CARD.md")).unwrap();
    assert!(card.contains(&directory.manifest().name));
    for owner in ["mocap.cs.cmu.edu", "AIST++ Dance Motion Dataset"] {
        assert!(card.contains(owner), "{owner} is not acknowledged");
    }
}

#[test]
fn its_manifest_is_unchanged_by_reading_and_writing() {
    let text = fs::read_to_string(project("models/default/manifest.json")).unwrap();
    let manifest: Manifest = serde_json::from_str(&text).unwrap();
    assert_eq!(serde_json::to_string_pretty(&manifest).unwrap() + "\n", text);
}

/// ARCHITECTURE section 7: one code repeated decodes to a still pose. That is why one frame can
/// stand for a code in `bailando codebook`.
#[test]
fn a_repeated_code_stands_still_and_another_one_moves() {
    let directory = ModelDirectory::open(&project("models/default")).unwrap();
    let mut decoder = directory.decoder(1).unwrap();
    let mut moved = |codes: &[u32]| {
        let codes: Vec<_> = codes.iter().map(|&code| [code; 2]).collect();
        let motion = decoder.decode(&codes).unwrap();
        // Metres from the first to the last frame of the two codes in the middle, mean of all
        // joints.
        let (first, last) = (motion.row(40), motion.row(55));
        let places = (1..24).map(|joint| {
            let axes =
                (3 * joint..3 * joint + 3).map(|column| (first[column] - last[column]).powi(2));
            axes.sum::<f32>().sqrt()
        });
        places.sum::<f32>() / 23.0
    };
    let (mut still, mut changing) = (Vec::new(), Vec::new());
    for code in (0..512).step_by(16) {
        let other = (code + 101) % 512;
        still.push(moved(&[code; 12]));
        changing.push(moved(&[[code; 6], [other; 6]].concat()));
    }
    let median = |mut values: Vec<f32>| {
        values.sort_by(f32::total_cmp);
        values[values.len() / 2]
    };
    let (still, changing) = (median(still), median(changing));
    println!("{still} m, {changing} m");
    assert!(still < 0.02, "a repeated code moves by {still} m");
    assert!(changing > 0.1, "a change of codes moves by {changing} m");
}

/// `export.lowest_pelvis` of `presets/styles.toml`: what a code repeated shows of the pelvis
/// decides.
#[test]
fn codes_of_a_pelvis_near_the_ground_are_suppressed_and_no_others() {
    const LOWEST: f32 = 0.5;
    let directory = ModelDirectory::open(&project("models/default")).unwrap();
    let mut decoder = directory.decoder(1).unwrap();
    let mut is_low = |code: u32| {
        let motion = decoder.decode(&[[0, code]; 9]).unwrap();
        let heights = (1..24).map(|joint| motion[[36, 3 * joint + 1]]);
        // Heights are above the root's.
        -heights.fold(0.0, f32::min) < LOWEST
    };
    let codes = directory.manifest().vocabulary.lower as u32;
    let low: Vec<u32> = (0..codes).filter(|&code| is_low(code)).collect();
    let suppressed = &directory.manifest().suppressed_codes;
    assert_eq!(suppressed.lower, low);
    assert!(suppressed.upper.is_empty());
}
