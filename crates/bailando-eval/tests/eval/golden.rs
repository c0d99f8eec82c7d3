//! Golden values of the ballroom set and the row of the salsa recordings; they need shared data.

use std::path::{Path, PathBuf};

use bailando_eval::{
    BeatScore, BeatsFrom, Clips, EvaluationOptions, FeatureRows, KineticForm, Metric, Motion,
    MotionQuality, Report, Scores, evaluate, load_motion, speed,
};
use bailando_motion::dance_beats;
use bailando_testkit::motion::write_motion;
use ndarray::Array2;

use crate::support::{close, json, options, random, reversed, rows};

/// The golden values and the ballroom set.
fn folders() -> Option<(PathBuf, PathBuf)> {
    let golden = bailando_testkit::shared("evaluation/golden")?;
    Some((golden, bailando_testkit::shared("data/dance-with-melody")?))
}

fn golden_rows(golden: &Path, suffix: &str, motions: &[Motion]) {
    let features = FeatureRows::new(motions, Clips::default(), KineticForm::Published);
    for (name, got) in [("kinetic", features.kinetic), ("geometric", features.geometric)] {
        let expected: Array2<f32> = rows(&golden.join(format!("{name}{suffix}.npy")));
        assert_eq!(got.dim(), expected.dim(), "{name}{suffix}");
        for ((at, &got), &expected) in got.indexed_iter().zip(&expected) {
            let expected = f64::from(expected);
            let near = (got - expected).abs() <= 1e-4 * expected.abs();
            assert!(near, "{name}{suffix} {at:?}: {got} {expected}");
        }
    }
}

/// The ballroom set's motions by id, in the order of the golden files.
fn ballroom(data: &Path, ids: &serde_json::Value) -> Vec<Motion> {
    let ids = ids.as_array().unwrap().iter();
    ids.map(|id| load_motion(&data.join(format!("{}.npy", id.as_str().unwrap()))).unwrap())
        .collect()
}

#[test]
fn features_are_golden() {
    let Some((golden, data)) = folders() else {
        return;
    };
    let ids = json(&golden.join("ids.json"));
    golden_rows(&golden, "", &ballroom(&data, &ids["reference"]));
    let backwards: Vec<Motion> =
        ballroom(&data, &ids["reversed"]).iter().map(|motion| reversed(motion).0).collect();
    golden_rows(&golden, "_reversed", &backwards);
}

/// Physical foot contact scores by a few lines of NumPy written from the published definition.
#[test]
fn foot_contact_is_golden() {
    let files = [
        ("data/salsa/60_01.npy", 0.325_188_269_107_725_7),
        ("data/salsa/61_15.npy", 0.680_129_835_831_189_1),
        ("data/dance-with-melody/C_1.npy", 0.663_329_204_410_252_2),
    ];
    for (file, expected) in files {
        let Some(file) = bailando_testkit::shared(file) else {
            return;
        };
        let motion = load_motion(&file).unwrap();
        let found = MotionQuality::new(motion.poses()).physical_foot_contact;
        close(found.unwrap(), expected, 1e-6, "physical foot contact");
    }
}

fn check_distances(scores: &Scores, expected: &serde_json::Value) {
    for metric in [Metric::FidK, Metric::FidG, Metric::DivK, Metric::DivG] {
        let expected = expected[metric.key()].as_f64().unwrap();
        close(scores.get(metric).unwrap(), expected, 1e-3, metric.key());
    }
}

#[test]
fn distances_are_golden() {
    let Some((golden, data)) = folders() else {
        return;
    };
    let expected = json(&golden.join("metrics.json"));
    let ids = json(&golden.join("ids.json"));
    let folder = tempfile::tempdir().unwrap();
    for motion in ballroom(&data, &ids["reversed"]) {
        let path = folder.path().join(format!("{}.npy", motion.name()));
        write_motion(&path, &reversed(&motion).1);
    }
    let report = evaluate(&options(folder.path(), &data)).unwrap();
    assert!(report.protocol.constant_kinetic_columns.is_empty());
    check_distances(&report.generated, &expected);
    check_distances(&report.reference, &expected["test_vs_reference"]);
    // The whole set against itself, which is its own "generated" folder.
    let whole = folder.path().join("whole");
    std::fs::create_dir(&whole).unwrap();
    for id in ids["reference"].as_array().unwrap() {
        let name = format!("{}.npy", id.as_str().unwrap());
        std::fs::copy(data.join(&name), whole.join(&name)).unwrap();
    }
    let report = evaluate(&options(&whole, &data)).unwrap();
    for (metric, key) in [(Metric::DivK, "reference_div_k"), (Metric::DivG, "reference_div_g")] {
        let expected = expected[key].as_f64().unwrap();
        close(report.generated.get(metric).unwrap(), expected, 1e-3, key);
    }
    assert!(report.generated.get(Metric::FidK).unwrap().abs() < 1e-3);
}

#[test]
fn beat_scores_are_golden() {
    let Some((golden, data)) = folders() else {
        return;
    };
    let expected = json(&golden.join("metrics.json"));
    let index = json(&data.join("index.json"));
    let mut pieces = 0;
    for piece in index["pieces"].as_array().unwrap() {
        let id = piece["id"].as_str().unwrap();
        let golden = &expected["bas_grid_beats"][id];
        let motion = load_motion(&data.join(format!("{id}.npy"))).unwrap();
        let beats = piece["grid_beats_s"].as_array().unwrap().iter();
        let beats: Vec<usize> = beats
            .map(|s| (s.as_f64().unwrap() * 60.0).round_ties_even())
            .filter(|frame| *frame >= 0.0)
            .map(|frame| frame as usize)
            .collect();
        let dance = dance_beats(&speed(motion.poses()));
        assert_eq!(golden["dance_beats"], dance.len(), "{id}");
        let score = BeatScore::new(motion.poses().len(), &beats, &dance, &mut random()).unwrap();
        let expected = |key: &str| golden[key].as_f64().unwrap();
        close(score.align, expected("bas"), 1e-4, id);
        close(score.align_dance, expected("beat_align_dance"), 1e-4, id);
        pieces += 1;
    }
    assert_eq!(pieces, 52);
}

fn salsa(generated: &Path) -> Option<Report> {
    let data = bailando_testkit::shared("data/salsa")?;
    let salsa = EvaluationOptions {
        split: Some("test".into()),
        beats: BeatsFrom::File(data.join("test_beats.json")),
        clips: Clips::Windows { length: 300, stride: 150 },
        ..options(generated, &data)
    };
    Some(evaluate(&salsa).unwrap())
}

#[test]
fn the_salsa_recordings_have_their_row() {
    let (Some(data), Some(quality)) = (
        bailando_testkit::shared("data/salsa"),
        bailando_testkit::shared("model/bootstrap/quality.json"),
    ) else {
        return;
    };
    let report = salsa(&data).unwrap();
    let row = &json(&quality)["gt"];
    // The data folder as its own generated set is its recordings.
    for scores in [&report.reference, &report.generated] {
        assert_eq!((scores.pieces, scores.samples), (42, 58));
        for (metric, key, tolerance) in [
            (Metric::FidK, "fid_k", 1e-3),
            (Metric::FidG, "fid_g", 1e-3),
            (Metric::DivK, "div_k", 1e-3),
            (Metric::DivG, "div_g", 1e-3),
            (Metric::BeatAlign, "bas", 1e-4),
            (Metric::Jerk, "jerk", 1e-4),
            (Metric::FootSkate, "skate", 1e-4),
        ] {
            let expected = row[key].as_f64().unwrap();
            close(scores.get(metric).unwrap(), expected, tolerance, key);
        }
        // Another generator's shifts: the mean of 42 x 20 of them.
        let chance = scores.get(Metric::BeatChance).unwrap();
        close(chance, row["chance"].as_f64().unwrap(), 0.02, "chance");
    }
    assert_eq!(report.protocol.reference_samples, 292);
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
}

/// A training take recites itself; the test takes are other motions.
#[test]
fn recitation_distinguishes_training_takes_from_others() {
    let Some(data) = bailando_testkit::shared("data/salsa") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    for id in ["60_01", "61_05"] {
        let name = format!("{id}.npy");
        std::fs::copy(data.join(&name), folder.path().join(format!("{id}_a.npy"))).unwrap();
    }
    let report = evaluate(&options(folder.path(), &data)).unwrap();
    assert_eq!(report.generated.get(Metric::Recitation), Some(1.0));
    assert!(report.reference.get(Metric::Recitation).unwrap() < 0.2);
}

#[test]
fn styles_of_recordings_are_recognised_that_were_not_learned() {
    let (Some(salsa), Some(street)) =
        (bailando_testkit::shared("data/salsa"), bailando_testkit::shared("data/street"))
    else {
        return;
    };
    let options = EvaluationOptions {
        split: Some("test".into()),
        clips: Clips::Windows { length: 300, stride: 150 },
        styles_from: vec![salsa, street.clone()],
        ..options(&street, &street)
    };
    let report = evaluate(&options).unwrap();
    let accuracy = report.reference.get(Metric::StyleAccuracy).unwrap();
    // Eleven styles: chance is 0.09.
    assert!(accuracy > 0.75, "{accuracy}");
    let pop = report.styles["pop"].reference.as_ref().unwrap();
    assert!(pop.get(Metric::StyleAccuracy).unwrap() > 0.9);
    // All of them asked for as one style: what looks like it is the part that is of it.
    let as_salsa = evaluate(&EvaluationOptions { style: Some("salsa".into()), ..options }).unwrap();
    assert!(as_salsa.generated.get(Metric::StyleAccuracy).unwrap() < 0.1);
}
