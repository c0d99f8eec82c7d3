//! Motions and music that the evaluation reads from files.

use std::{
    num::NonZeroUsize,
    path::{Path, PathBuf},
};

use bailando_eval::{BeatsFrom, EvaluationOptions, Metric, Motion, evaluate, load_motion};
use bailando_formats::{BvhUnit, Encoding, JsonOptions, to_bvh, to_json};
use bailando_motion::{FinishOptions, Positions, forward};
use bailando_testkit::motion::{dance_of, fixture, folders, sway, write_motion};

use crate::support::{close, options};

/// Largest distance of a joint, metres.
fn apart(motion: &Motion, positions: &Positions) -> f64 {
    assert_eq!(motion.poses().len(), positions.dim().0);
    let distance = |frame: usize, joint: usize| {
        let place = motion.poses()[frame][joint].to_array();
        let axes = place.into_iter().enumerate();
        let squares =
            axes.map(|(axis, a)| (a - f64::from(positions[(frame, joint, axis)])).powi(2));
        squares.sum::<f64>().sqrt()
    };
    let frames = 0..motion.poses().len();
    let all = frames.flat_map(|frame| (0..24).map(move |joint| (frame, joint)));
    all.map(|(frame, joint)| distance(frame, joint)).fold(0.0, f64::max)
}

/// Copies of the demo song with some names, in a folder inside another.
fn songs(folder: &Path, names: impl Iterator<Item = String>) -> PathBuf {
    let songs = folder.join("songs");
    std::fs::create_dir(&songs).unwrap();
    let demo = bailando_testkit::fixture("audio/demo_44k1_8s.wav");
    for name in names {
        std::fs::copy(&demo, songs.join(name).with_extension("wav")).unwrap();
    }
    songs
}

#[test]
fn every_format_of_a_dance_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let dance = dance_of(&fixture("decode_raw.npy"), &FinishOptions::default());
    let read = |name: &str, bytes: Vec<u8>| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        load_motion(&path).unwrap()
    };
    for encoding in [Encoding::Json, Encoding::Base64] {
        let options = JsonOptions { encoding, ..JsonOptions::default() };
        let motion = read("dance.json", to_json(&dance, &options).unwrap());
        assert!(apart(&motion, &dance.positions) < 2e-6, "{encoding:?}");
        let codes = [dance.codes.upper.clone(), dance.codes.lower.clone()];
        assert_eq!(motion.codes(), Some(&codes));
    }
    let rotated = forward(&dance.skeleton, &dance.animation).unwrap();
    for unit in [BvhUnit::Centimetre, BvhUnit::Metre] {
        let motion = read("dance.bvh", to_bvh(&dance, unit).unwrap().into_bytes());
        // Angles are rounded to 1e-4 degrees.
        assert!(apart(&motion, &rotated) < 1e-4, "{unit:?}");
        assert_eq!(motion.name(), "dance");
    }
    let path = folder.path().join("dance.npy");
    write_motion(&path, &dance.positions);
    assert_eq!(apart(&load_motion(&path).unwrap(), &dance.positions), 0.0);
}

#[test]
fn beats_are_found_in_audio_files() {
    let (folder, reference, generated) = folders();
    let songs = songs(folder.path(), (0..6).map(|at| format!("song{at}")));
    let audio =
        EvaluationOptions { beats: BeatsFrom::Audio(songs), ..options(&generated, &reference) };
    let report = evaluate(&audio).unwrap();
    let source = "column 53 of the audio's features";
    assert_eq!(report.protocol.beats, Some(source));
    let score = report.generated.get(Metric::BeatAlign).unwrap();
    assert!(score > 0.0 && score < 1.0, "{score}");
    let chance = report.generated.get(Metric::BeatChance).unwrap();
    let margin = report.generated.get(Metric::BeatMargin).unwrap();
    close(margin, score - chance, 1e-9, "margin");
}

#[test]
fn motions_to_new_songs_are_no_pieces_of_the_reference() {
    let (folder, reference, generated) = folders();
    let songs = songs(folder.path(), (0..3).map(|at| format!("new{at}")));
    for at in 0..3 {
        let [old, new] = ["song", "new"].map(|name| generated.join(format!("{name}{at}.npy")));
        std::fs::rename(old, new).unwrap();
    }
    let new = EvaluationOptions {
        beats: BeatsFrom::NewSongs { folder: songs.clone(), beats: None },
        ..options(&generated, &reference)
    };
    let report = evaluate(&EvaluationOptions { form: true, ..new.clone() }).unwrap();
    assert!(report.generated.get(Metric::BeatMargin).is_some());
    assert_eq!(report.reference.get(Metric::Form), None);
    assert_eq!(report.reference.get(Metric::BeatAlign), None);
    assert!(report.generated.get(Metric::FidK).is_some());
    std::fs::remove_file(songs.join("new1.wav")).unwrap();
    let problem = evaluate(&new).unwrap_err().to_string();
    assert!(problem.contains("no audio named new1"), "{problem}");
    // With a file of beats no song is needed.
    let file = folder.path().join("beats.json");
    let told = BeatsFrom::NewSongs { folder: songs, beats: Some(file.clone()) };
    let told = EvaluationOptions { beats: told, ..new };
    std::fs::write(&file, r#"{"new0": [30, 60], "new1": [30, 90], "new2": [45, 60]}"#).unwrap();
    let report = evaluate(&told).unwrap();
    assert!(report.generated.get(Metric::BeatMargin).is_some());
    assert_eq!(report.reference.get(Metric::BeatAlign), None);
    std::fs::write(&file, r#"{"new0": [30, 60]}"#).unwrap();
    let problem = evaluate(&told).unwrap_err().to_string();
    assert!(problem.contains("new1"), "{problem}");
}

#[test]
fn several_seeds_are_a_mean_with_intervals() {
    let (_folder, reference, generated) = folders();
    for (seed, offset) in [("seed1", 0.1), ("seed2", 0.2)] {
        let own = generated.join(seed);
        std::fs::create_dir(&own).unwrap();
        for at in 0..3 {
            let pace = 2.0 + 0.5 * at as f32 + offset;
            write_motion(&own.join(format!("song{at}.npy")), &sway(400, pace));
        }
    }
    let with = |seeds| EvaluationOptions {
        seeds: NonZeroUsize::new(seeds),
        ..options(&generated, &reference)
    };
    let report = evaluate(&with(2)).unwrap();
    let sets = report.sets.iter();
    let each: Vec<f64> = sets.map(|set| set.get(Metric::FidK).unwrap()).collect();
    let mean = report.generated.get(Metric::FidK).unwrap();
    close(mean, 0.5 * (each[0] + each[1]), 1e-12, "mean");
    // Two values: 12.7062 times half of their difference.
    let margin = 12.7062 * 0.5 * (each[0] - each[1]).abs();
    close(report.margin95["fid_k"], margin, 1e-6, "margin");
    let message = evaluate(&with(3)).unwrap_err().to_string();
    assert!(message.contains("has 2 (seed1, seed2)"), "{message}");
}
