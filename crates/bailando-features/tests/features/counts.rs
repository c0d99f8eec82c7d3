//! Counts and bars of songs whose counts and bars are known.

use std::{f64::consts::TAU, fs};

use bailando_features::{BeatPhase, FeatureExtractor, Profile, Rate};
use serde_json::Value;

/// Mean difference of the counts found to the true ones on `grid_s`, in turns of `period` counts,
/// and its steadiness: the length of the mean direction.
fn difference(phase: &BeatPhase, grid_s: &[f64], period: f64) -> (f64, f64) {
    let angles = grid_s
        .iter()
        .enumerate()
        .map(|(count, &second)| TAU * (phase.at(second) - count as f64) / period);
    let (sine, cosine) =
        angles.fold((0.0, 0.0), |(sine, cosine), angle| (sine + angle.sin(), cosine + angle.cos()));
    let turns = sine.atan2(cosine) / TAU;
    (turns * period, sine.hypot(cosine) / grid_s.len() as f64)
}

/// Where the tracker finds the beat or half of it, counts are on the grid, and bars start where the
/// songs' harmony changes.
#[test]
fn counts_and_bars_of_known_songs_are_found() {
    let Some(root) = bailando_testkit::shared("data/salsa") else {
        return;
    };
    let index: Value = bailando_testkit::read_json(&root.join("index.json"));
    let mut rows = FeatureExtractor::new(Rate::Conditioning, Profile::Librosa011);
    let mut beats = FeatureExtractor::new(Rate::Beats, Profile::Librosa011);
    let (mut songs, mut on_count, mut on_bar) = (0, 0, 0);
    let pieces = index["pieces"].as_array().unwrap().iter();
    for piece in pieces.filter(|piece| piece["split"] == "test" && piece["role"] == "lead") {
        let bytes = fs::read(root.join(piece["audio"].as_str().unwrap())).unwrap();
        let decoded = bailando_audio::decode(
            bytes.into(),
            Default::default(),
            &[Rate::Conditioning.hz(), Rate::Beats.hz()],
            &bailando_audio::AudioLimits::default(),
            &bailando_core::CancelToken::new(),
        );
        let signals = decoded.unwrap().signals;
        let rows = rows.extract(&signals[0]).unwrap();
        let phase = BeatPhase::find(&beats.beats(&signals[1]).unwrap(), rows.view()).unwrap();
        let grid: Vec<f64> = serde_json::from_value(piece["grid_beats_s"].clone()).unwrap();
        let found = |period: f64| {
            let (counts, steady) = difference(&phase, &grid, period);
            usize::from(counts.abs() < 0.25 && steady > 0.8)
        };
        songs += 1;
        on_count += found(1.0);
        on_bar += found(4.0);
    }
    println!("of {songs} songs {on_count} on the count, {on_bar} in the bar");
    assert!(songs > 0 && on_count * 5 >= songs * 4);
    assert!(on_bar * 2 >= songs);
}
