//! The models that tests of the service run are what the trainer writes, and the same bytes from
//! every container of the golden checkpoints.
//!
//! `UPDATE_MODELS=1 cargo test -p bailando-train --test main tiny_models` writes them again.

use std::{fs, path::Path};

use crate::common::{
    dancer::{counting, turning, widened},
    fixture, imported, options, vqvae,
};
use bailando::{
    features::Profile,
    model::{
        CountSource, ModelDirectory, STATISTICS, StyleClassifier, SuppressedCodes, WeightStorage,
    },
    motion::MotionFrame,
};
use bailando_testkit::{
    model::{tiny, tiny_dancer, tiny_styles},
    shared,
};
use bailando_train::{
    export::{Description, write_model_directory},
    import::import,
    onnx::InputRanges,
};

const FILES: [&str; 4] = ["manifest.json", "gpt.onnx", "decoder.onnx", "encoder.onnx"];
const STYLES: [&str; 3] = ["house", "krump", "lock"];
const COUNT_PERIODS: [u32; 2] = [1, 4];

/// Writes the model of the golden checkpoints.
fn write_tiny(out: &Path) {
    let mut options = options(&fixture("tiny_vqvae.pt"), &fixture("tiny_gpt.pt"), out);
    options.replace = true;
    import(&options).unwrap();
}

/// Writes a model with all that was added to the published one.
fn write_tiny_dancer(out: &Path) {
    let gpt = counting(COUNT_PERIODS.len());
    let description = Description {
        name: "tiny dancer".into(),
        profile: Profile::Librosa011,
        count_periods: COUNT_PERIODS.into(),
        counts: CountSource::default(),
        start_codes: vec![[8, 3], [0, 15], [11, 4]],
        suppressed_codes: SuppressedCodes { upper: vec![7], lower: vec![2, 9] },
        temperature: 1.0,
        guidance: 1.5,
        candidates: 2,
        redo: true,
        hop: 4,
        motion_frame: MotionFrame::Dancer,
        weights: WeightStorage::Int8,
        ..options(Path::new(""), Path::new(""), out).description
    };
    let ranges = InputRanges::default();
    write_model_directory(out, true, &gpt, &ranges, &turning(), &description).unwrap();
}

/// Writes a model of styles and energies, with a classifier of songs.
fn write_tiny_styles(out: &Path) {
    // Two columns for a period of counts, one for each style, two for the energy.
    let gpt = widened(2 + STYLES.len() + 2, 20.0);
    let description = Description {
        name: "tiny styles".into(),
        profile: Profile::Librosa011,
        count_periods: vec![4],
        counts: CountSource::default(),
        styles: STYLES.map(str::to_owned).into(),
        energy: true,
        classifier: Some(classifier()),
        temperature: 1.0,
        ..options(Path::new(""), Path::new(""), out).description
    };
    let ranges = InputRanges::default();
    write_model_directory(out, true, &gpt, &ranges, &vqvae(), &description).unwrap();
}

/// The mean of a feature column is high in each style.
fn classifier() -> StyleClassifier {
    let weights = |style: usize| {
        (0..STATISTICS).map(move |place| if place == style { 2.0 } else { 0.0 }).collect()
    };
    StyleClassifier {
        styles: STYLES.map(str::to_owned).into(),
        mean: vec![0.0; STATISTICS],
        spread: vec![1.0; STATISTICS],
        weights: (0..STYLES.len()).map(weights).collect(),
        bias: vec![0.0; STYLES.len()],
        least: 0.6,
        farthest: 100.0,
    }
}

/// Fails where a file of two model directories differs.
fn assert_same_files(found: &Path, expected: &Path, what: &str) {
    for name in FILES {
        let [found, expected] = [found, expected].map(|folder| fs::read(folder.join(name)));
        assert!(found.unwrap() == expected.unwrap(), "{what}: {name} has other bytes");
    }
}

#[test]
fn the_tiny_models_are_what_the_trainer_writes() {
    type Write = fn(&Path);
    let models = [
        (tiny(), write_tiny as Write),
        (tiny_dancer(), write_tiny_dancer),
        (tiny_styles(), write_tiny_styles),
    ];
    for (model, write) in models {
        if std::env::var_os("UPDATE_MODELS").is_some() {
            write(&model);
        }
        let folder = tempfile::tempdir().unwrap();
        let written = folder.path().join("model");
        write(&written);
        assert_same_files(&written, &model, "written again");
    }
    let [written, kept] = [
        classifier(),
        ModelDirectory::open(&tiny_styles()).unwrap().style_classifier().unwrap().unwrap(),
    ];
    assert_eq!(written, kept);
}

#[test]
fn every_container_of_the_golden_checkpoints_gives_the_same_model() {
    let Some(golden) = shared("model/golden") else {
        return;
    };
    for (vqvae, gpt) in [
        ("tiny_vqvae_legacy.pt", "tiny_gpt_legacy.pt"),
        ("tiny_vqvae_torch16.pt", "tiny_gpt_torch16.pt"),
        ("tiny_vqvae.pt", "tiny_gpt_nocritic.pt"),
    ] {
        let (folder, _) = imported(|options| {
            options.vqvae = golden.join(vqvae);
            options.gpt = golden.join(gpt);
        });
        assert_same_files(&folder.path().join("model"), &tiny(), gpt);
    }
}
