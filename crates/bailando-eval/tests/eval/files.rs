//! Motions and music that the evaluation reads from files.

use std::num::NonZeroUsize;

use bailando_eval::{BeatsFrom, EvaluationOptions, Metric, Motion, Pose, evaluate, load_motion};
use bailando_formats::{BvhUnit, Encoding, JsonOptions, to_bvh, to_json};
use bailando_motion::{FinishOptions, Positions, forward};
use bailando_testkit::motion::{dance_of, fixture, folders, sway, write_motion};
use ndarray::ArrayView2;

use crate::support::{close, options};

/// Largest distance of a joint, metres.
fn apart(motion: &Motion, positions: &Positions) -> f64 {
    assert_eq!(motion.poses().len(), positions.dim().0);
    let poses = motion.poses().iter().zip(positions.outer_iter());
    let distance = |(pose, cells): (&Pose, ArrayView2<'_, f32>)| {
        let joints = pose.iter().zip(cells.outer_iter());
        let squares = joints.map(|(place, cell)| {
            let axes = place.to_array().into_iter().zip(&cell);
            axes.map(|(a, &b)| (a - f64::from(b)).powi(2)).sum::<f64>()
        });
        squares.fold(0.0, f64::max).sqrt()
    };
    poses.map(distance).fold(0.0, f64::max)
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
        let options = JsonOptions {
            encoding,
            ..JsonOptions::default()
        };
        let motion = read("dance.json", to_json(&dance, &options).unwrap());
        assert!(apart(&motion, &dance.positions) < 2e-6, "{encoding:?}");
        assert_eq!(
            motion.codes(),
            Some(&[dance.codes.upper.clone(), dance.codes.lower.clone()])
        );
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

/// The demo song's beats are those of its features, whichever way they come.
#[test]
fn music_is_heard_in_audio_files() {
    let (folder, reference, generated) = folders();
    let songs = folder.path().join("songs");
    std::fs::create_dir(&songs).unwrap();
    let demo = bailando_testkit::fixture("audio/demo_44k1_8s.wav");
    for at in 0..6 {
        std::fs::copy(&demo, songs.join(format!("song{at}.wav"))).unwrap();
    }
    let heard = EvaluationOptions {
        beats: BeatsFrom::Audio(songs),
        ..options(&generated, &reference)
    };
    let report = evaluate(&heard).unwrap();
    assert_eq!(
        report.protocol.beats.as_deref(),
        Some("column 53 of the audio's features")
    );
    let score = report.generated.get(Metric::BeatAlign).unwrap();
    assert!(score > 0.0 && score < 1.0, "{score}");
    let chance = report.generated.get(Metric::BeatChance).unwrap();
    let margin = report.generated.get(Metric::BeatMargin).unwrap();
    close(margin, score - chance, 1e-9, "margin");
}

#[test]
fn dances_to_new_songs_are_no_pieces_of_the_reference() {
    let (folder, reference, generated) = folders();
    let songs = folder.path().join("songs");
    std::fs::create_dir(&songs).unwrap();
    let demo = bailando_testkit::fixture("audio/demo_44k1_8s.wav");
    for at in 0..3 {
        let name = format!("new{at}");
        std::fs::copy(&demo, songs.join(&name).with_extension("wav")).unwrap();
        let dance = generated.join(format!("song{at}.npy"));
        std::fs::rename(dance, generated.join(name).with_extension("npy")).unwrap();
    }
    let new = EvaluationOptions {
        beats: BeatsFrom::NewSongs(songs.clone()),
        ..options(&generated, &reference)
    };
    let report = evaluate(&new).unwrap();
    assert!(report.generated.get(Metric::BeatMargin).is_some());
    assert_eq!(report.reference.get(Metric::BeatAlign), None);
    assert!(report.generated.get(Metric::FidK).is_some());
    std::fs::remove_file(songs.join("new1.wav")).unwrap();
    let problem = evaluate(&new).unwrap_err().to_string();
    assert!(problem.contains("no audio named new1"), "{problem}");
}

#[test]
fn several_seeds_are_a_mean_with_intervals() {
    let (_folder, reference, generated) = folders();
    for seed in ["seed1", "seed2"] {
        let own = generated.join(seed);
        std::fs::create_dir(&own).unwrap();
        for at in 0..3 {
            let pace = 2.0 + 0.5 * at as f32 + if seed == "seed1" { 0.1 } else { 0.2 };
            write_motion(&own.join(format!("song{at}.npy")), &sway(400, pace));
        }
    }
    let seeds = EvaluationOptions {
        seeds: NonZeroUsize::new(2),
        ..options(&generated, &reference)
    };
    let report = evaluate(&seeds).unwrap();
    let each: Vec<f64> = report
        .sets
        .iter()
        .map(|set| set.get(Metric::FidK).unwrap())
        .collect();
    let mean = report.generated.get(Metric::FidK).unwrap();
    close(mean, 0.5 * (each[0] + each[1]), 1e-12, "mean");
    // Two values: 12.7062 times half of their difference.
    close(
        report.margin95["fid_k"],
        12.7062 * 0.5 * (each[0] - each[1]).abs(),
        1e-6,
        "margin",
    );
    let three = EvaluationOptions {
        seeds: NonZeroUsize::new(3),
        ..seeds
    };
    let message = evaluate(&three).unwrap_err().to_string();
    assert!(message.contains("has 2 (seed1, seed2)"), "{message}");
}
