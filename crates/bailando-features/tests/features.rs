//! The feature chain against the golden vectors of librosa, stage by stage.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    unreachable_pub,
    reason = "a test crate: helpers fail loudly, report what they measured, and are public to it only"
)]

#[path = "features/comparison.rs"]
mod comparison;
#[path = "features/golden.rs"]
mod golden;

use std::path::Path;

use bailando_features::{
    BEAT_COLUMN, BeatPhase, Beats, CHROMA_COLUMNS, COLUMNS, DELTA_COLUMNS, FeatureExtractor,
    MFCC_COLUMNS, ONSET_COLUMN, Profile, Rate, Stages, TEMPOGRAM_COLUMNS,
};
use comparison::{Checked, Tolerance, frames_with_tone};
use golden::{GoldenSet, load, load_as_f32, load_vector};
use ndarray::{Array2, Axis, Slice};

/// Every clip of the golden set in the newer profile, every stage that has a file.
#[test]
fn golden_clips_of_librosa_0_11() {
    let Some(root) = bailando_testkit::shared("features/golden") else {
        return;
    };
    let set = GoldenSet::read(&root);
    let mut checked = Checked::default();
    for (name, clip) in set.clips() {
        let pcm = load_vector(&root.join(name).join("pcm.npy"));
        let mut extractor = FeatureExtractor::new(rate_of(clip), Profile::Librosa011);
        let stages = extractor.extract_stages(&pcm).unwrap();
        for (stage, about) in clip["stages"].as_object().unwrap() {
            let file = root.join(about["file"].as_str().unwrap());
            let tolerance = Tolerance::of(about);
            match stage.as_str() {
                "pcm" => assert_eq!(pcm.len() as u64, about["shape"][0].as_u64().unwrap()),
                "stft_mag_40" => {
                    let got = extractor.stft_magnitudes(&pcm, 40).unwrap();
                    checked.compare(stage, name, &got, &rows(&file), tolerance);
                }
                "cqt_mag" => {
                    // With the golden tuning, so that a wrong one shows in its own stage only.
                    let tuning = clip["tuning"].as_f64().unwrap();
                    let got = extractor.cqt(&stages.harmonic, tuning).unwrap();
                    checked.compare(stage, name, &got, &rows(&file), tolerance);
                }
                "features" => {
                    let (expected, groups) = (load(&file), &about["columns"]);
                    checked.matrix(name, &stages.features, &expected, &stages.cqt, groups);
                }
                _ => compare_stage(&mut checked, name, stage, &stages, &file, tolerance),
            }
        }
        check_tuning(name, stages.tuning, clip);
        check_beats(
            name,
            &stages.beats,
            &clip["tempo_bpm"],
            &clip["beat_frames"],
        );
        check_shortcuts(name, &mut extractor, &pcm, &stages);
    }
    checked.report("librosa 0.11");
    assert_eq!(set.clips().len(), 14);
    checked.assert_clips(&[
        ("stft_mag_40", 9),
        ("mel_db", 12),
        ("mfcc", 12),
        ("mfcc_delta", 12),
        ("harmonic", 9),
        ("percussive", 9),
        ("tuning", 14),
        ("cqt_mag", 12),
        ("chroma_cqt", 14),
        ("onset_env", 14),
        ("tempogram", 12),
        ("tempo", 14),
        ("beats", 14),
        ("features", 14),
    ]);
}

/// Every clip in the older profile: columns 0..54, and the tempogram where there is a file.
#[test]
fn golden_clips_of_librosa_0_8_1() {
    let Some(shared) = bailando_testkit::shared("features") else {
        return;
    };
    let (root, inputs) = (shared.join("golden_081"), shared.join("golden"));
    let set = GoldenSet::read(&root);
    let mut checked = Checked::default();
    for (name, clip) in set.clips() {
        let pcm = load_vector(&inputs.join(name).join("pcm.npy"));
        let mut extractor = FeatureExtractor::new(rate_of(clip), Profile::Librosa081);
        let stages = extractor.extract_stages(&pcm).unwrap();
        let features = &stages.features;
        compare_first_columns(
            &mut checked,
            name,
            &stages,
            &load(&root.join(name).join("features54.npy")),
            &clip["columns_tol"],
        );
        let tempogram = columns(features, TEMPOGRAM_COLUMNS);
        if clip.get("tempogram").is_some() {
            let expected = rows(&root.join(name).join("tempogram.npy"));
            checked.compare(
                "tempogram",
                name,
                &tempogram,
                &expected,
                Tolerance::absolute(2e-4),
            );
        }
        if clip["onset_all_zero"].as_bool().unwrap() {
            assert!(
                columns(features, 52..COLUMNS).iter().all(|&x| x == 0.0),
                "{name}"
            );
        }
        check_tuning(name, stages.tuning, clip);
        check_beats(
            name,
            &stages.beats,
            &clip["tempo_bpm"],
            &clip["beat_frames"],
        );
        check_shortcuts(name, &mut extractor, &pcm, &stages);
    }
    checked.report("librosa 0.8.1");
    assert_eq!(set.clips().len(), 12);
    checked.assert_clips(&[
        ("mfcc", 12),
        ("mfcc_delta", 12),
        ("chroma_cqt", 12),
        ("onset_env", 12),
        ("beats", 12),
        ("tempogram", 8),
    ]);
}

/// Compares columns 0..54 of a clip in the older profile.
fn compare_first_columns(
    checked: &mut Checked,
    clip: &str,
    stages: &Stages,
    expected: &Array2<f32>,
    limits: &serde_json::Value,
) {
    assert_eq!(expected.dim(), (stages.features.nrows(), 54));
    let limit = |stage: &str| limits[stage].as_f64().unwrap();
    for (stage, range, limit) in [
        ("mfcc", MFCC_COLUMNS, limit("mfcc")),
        ("mfcc_delta", DELTA_COLUMNS, limit("mfcc_delta")),
        // The bound for the decimation filter of 0.8.1 itself, which is the one used.
        ("chroma_cqt", CHROMA_COLUMNS, 1e-3),
        ("onset_env", ONSET_COLUMN..BEAT_COLUMN, limit("onset")),
        ("beats", BEAT_COLUMN..54, limit("beats")),
    ] {
        let got = columns(&stages.features, range.clone());
        let expected = columns(expected, range);
        let frames = if stage == "chroma_cqt" {
            frames_with_tone(&stages.cqt)
        } else {
            (0..expected.nrows()).collect()
        };
        checked.compare(
            stage,
            clip,
            &got.select(Axis(0), &frames),
            &expected.select(Axis(0), &frames),
            Tolerance::absolute(limit),
        );
    }
}

/// Beats of six whole songs at both rates, from their golden envelopes, in both profiles.
#[test]
fn golden_beats_of_whole_songs() {
    let Some(shared) = bailando_testkit::shared("features") else {
        return;
    };
    let (root, older) = (shared.join("golden"), shared.join("golden_081"));
    let songs = GoldenSet::read(&root).beats_only();
    assert_eq!(songs.len(), 6);
    for (name, song) in &songs {
        let folder = root.join(song["dir"].as_str().unwrap());
        let onset = load_vector(&folder.join("onset_env.npy"));
        assert_eq!(onset.len() as u64, song["n_frames"].as_u64().unwrap());
        let expected = load_frames(&folder.join("beat_frames.npy"));
        assert_eq!(expected.len() as u64, song["n_beats"].as_u64().unwrap());
        let tempo = f64::from(load_as_f32(&folder.join("tempo.npy"))[0]);
        let rate = rate_of(song);
        let beats = FeatureExtractor::new(rate, Profile::Librosa011).beats_of_onset(&onset);
        assert!(
            (beats.tempo_bpm / tempo - 1.0).abs() < 1e-6,
            "{name}: tempo"
        );
        assert_eq!(beats.frames, expected, "{name}");
    }

    let songs_of_older = GoldenSet::read(&older).beats_only();
    assert_eq!(songs_of_older.len(), 6);
    for (name, song) in &songs_of_older {
        let onset = load_vector(&root.join("beats_only").join(name).join("onset_env.npy"));
        let expected = load_frames(&older.join(song["file"].as_str().unwrap()));
        assert_eq!(expected.len() as u64, song["n_beats"].as_u64().unwrap());
        let rate = rate_of(&songs[name]);
        let beats = FeatureExtractor::new(rate, Profile::Librosa081).beats_of_onset(&onset);
        let tempo = song["tempo_bpm"].as_f64().unwrap();
        assert!(
            (beats.tempo_bpm / tempo - 1.0).abs() < 1e-6,
            "{name}: tempo"
        );
        assert_eq!(beats.frames, expected, "{name}");
    }
}

/// A resampled excerpt, from its samples at 3,840 Hz.
#[test]
fn golden_matrix_of_a_resampled_excerpt() {
    let Some(folder) = bailando_testkit::shared("features/golden/resample_5s") else {
        return;
    };
    let pcm = load_vector(&folder.join("mono_3840.npy"));
    let mut extractor = FeatureExtractor::new(Rate::Conditioning, Profile::Librosa011);
    let stages = extractor.extract_stages(&pcm).unwrap();
    Checked::default().matrix(
        "resample_5s",
        &stages.features,
        &load(&folder.join("features_3840.npy")),
        &stages.cqt,
        &golden::column_tolerances(),
    );
}

/// Music of our own, which the repository holds: runs on a clone that stands alone.
#[test]
fn golden_clips_of_our_own() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/features");
    let set = GoldenSet::read(&root);
    let mut checked = Checked::default();
    for (name, clip) in set.clips() {
        let pcm = load_vector(&root.join(name).join("pcm.npy"));
        assert_eq!(pcm.len() as u64, clip["samples"].as_u64().unwrap());
        let mut extractor = FeatureExtractor::new(rate_of(clip), Profile::Librosa011);
        let stages = extractor.extract_stages(&pcm).unwrap();
        assert_eq!(
            stages.features.nrows() as u64,
            clip["frames"].as_u64().unwrap()
        );
        for stage in clip["files"].as_array().unwrap() {
            let stage = stage.as_str().unwrap();
            let file = root.join(name).join(format!("{stage}.npy"));
            if stage == "features" {
                let groups = golden::column_tolerances();
                checked.matrix(name, &stages.features, &load(&file), &stages.cqt, &groups);
            } else {
                let tolerance = golden::tolerance_of(stage);
                compare_stage(&mut checked, name, stage, &stages, &file, tolerance);
            }
        }
        check_tuning(name, stages.tuning, clip);
        check_beats(name, &stages.beats, &clip["tempo"], &clip["beats"]);
        check_shortcuts(name, &mut extractor, &pcm, &stages);
    }
    checked.report("our own");
    assert_eq!(set.clips().len(), 2);
    checked.assert_clips(&[
        ("features", 2),
        ("tuning", 2),
        ("tempo", 2),
        ("onset_env", 2),
        ("mel_db", 1),
        ("harmonic", 1),
        ("percussive", 1),
        ("cqt_mag", 1),
    ]);
}

/// Compares one stage of a clip with its file.
fn compare_stage(
    checked: &mut Checked,
    clip: &str,
    stage: &str,
    stages: &Stages,
    file: &Path,
    tolerance: Tolerance,
) {
    let features = &stages.features;
    let (mut got, mut expected) = match stage {
        "mel_db" => (stages.mel_db.clone(), rows(file)),
        "mfcc" => (columns(features, MFCC_COLUMNS), rows(file)),
        "mfcc_delta" => (columns(features, DELTA_COLUMNS), rows(file)),
        "harmonic" => (column(&stages.harmonic), vector(file)),
        "percussive" => (column(&stages.percussive), vector(file)),
        "tuning" => (column(&[stages.tuning as f32]), vector(file)),
        "cqt_mag" => (stages.cqt.clone(), rows(file)),
        "chroma_cqt" => (columns(features, CHROMA_COLUMNS), rows(file)),
        "onset_env" => (
            columns(features, ONSET_COLUMN..ONSET_COLUMN + 1),
            vector(file),
        ),
        "tempogram" => (columns(features, TEMPOGRAM_COLUMNS), rows(file)),
        "tempo" => (column(&[stages.beats.tempo_bpm as f32]), vector(file)),
        "beats" => (
            columns(features, BEAT_COLUMN..BEAT_COLUMN + 1),
            vector(file),
        ),
        unknown => panic!("{clip}: no comparison for stage {unknown}"),
    };
    if stage == "chroma_cqt" {
        let frames = frames_with_tone(&stages.cqt);
        got = got.select(Axis(0), &frames);
        expected = expected.select(Axis(0), &frames);
    }
    checked.compare(stage, clip, &got, &expected, tolerance);
}

/// The shorter ways to a result give the same one.
fn check_shortcuts(clip: &str, extractor: &mut FeatureExtractor, pcm: &[f32], stages: &Stages) {
    assert_eq!(
        stages.features,
        extractor.extract(pcm).unwrap(),
        "{clip}: extract"
    );
    assert_eq!(stages.beats, extractor.beats(pcm).unwrap(), "{clip}: beats");
}

fn rate_of(clip: &serde_json::Value) -> Rate {
    match clip["sr"].as_u64() {
        Some(3_840) => Rate::Conditioning,
        Some(30_720) => Rate::Beats,
        other => panic!("no such rate: {other:?}"),
    }
}

/// Exact: tunings are multiples of 0.01, and reading them from JSON may cost the last bit.
fn check_tuning(name: &str, tuning: f64, clip: &serde_json::Value) {
    let expected = clip["tuning"].as_f64().unwrap();
    assert!(
        (tuning - expected).abs() < 1e-12,
        "{name}: tuning {tuning} instead of {expected}"
    );
}

fn check_beats(clip: &str, beats: &Beats, tempo: &serde_json::Value, frames: &serde_json::Value) {
    let tempo = tempo.as_f64().unwrap();
    assert!(
        (beats.tempo_bpm - tempo).abs() <= 1e-5 * tempo,
        "{clip}: tempo {} instead of {tempo}",
        beats.tempo_bpm
    );
    let got: Vec<u64> = beats.frames.iter().map(|&frame| frame as u64).collect();
    assert_eq!(got, golden::integers(frames), "{clip}: beats");
}

/// A golden `[n, frames]` file as rows of frames.
fn rows(file: &Path) -> Array2<f32> {
    load::<f32, ndarray::Ix2>(file).reversed_axes()
}

fn vector(file: &Path) -> Array2<f32> {
    column(&load_as_f32(file))
}

fn column(values: &[f32]) -> Array2<f32> {
    Array2::from_shape_fn((values.len(), 1), |(row, _)| values[row])
}

fn columns(matrix: &Array2<f32>, range: std::ops::Range<usize>) -> Array2<f32> {
    matrix.slice_axis(Axis(1), Slice::from(range)).to_owned()
}

fn load_frames(file: &Path) -> Vec<usize> {
    let frames = load::<i32, ndarray::Ix1>(file);
    frames.iter().map(|&frame| frame as usize).collect()
}

/// Songs whose counts and bars are known: where our tracker finds the beat or half of it, counts are on the
/// grid, and bars start where the songs' harmony changes.
#[test]
fn counts_and_bars_of_known_songs_are_found() {
    let Some(root) = bailando_testkit::shared("data/salsa") else {
        return;
    };
    let text = std::fs::read(root.join("index.json")).unwrap();
    let index: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let mut rows = FeatureExtractor::new(Rate::Conditioning, Profile::Librosa011);
    let mut beats = FeatureExtractor::new(Rate::Beats, Profile::Librosa011);
    let (mut songs, mut on_count, mut on_bar) = (0, 0, 0);
    let pieces = index["pieces"].as_array().unwrap().iter();
    for piece in pieces.filter(|piece| piece["split"] == "test" && piece["role"] == "lead") {
        let bytes = std::fs::read(root.join(piece["audio"].as_str().unwrap())).unwrap();
        let signals = bailando_audio::decode(
            bytes.into(),
            Default::default(),
            &[Rate::Conditioning.hz(), Rate::Beats.hz()],
            &bailando_audio::AudioLimits::default(),
            &bailando_core::CancelToken::new(),
        )
        .unwrap()
        .signals;
        let rows = rows.extract(&signals[0]).unwrap();
        let phase = BeatPhase::find(&beats.beats(&signals[1]).unwrap(), rows.view()).unwrap();
        let grid = piece["grid_beats_s"].as_array().unwrap().iter();
        let grid: Vec<f64> = grid.map(|second| second.as_f64().unwrap()).collect();
        // Mean direction of the difference to the true count, in turns of `period`; its length says how
        // steady it is.
        let difference = |period: f64| {
            let angles = grid.iter().enumerate().map(|(count, &second)| {
                std::f64::consts::TAU * (phase.at(second) - count as f64) / period
            });
            let (sine, cosine) = angles.fold((0.0, 0.0), |(sine, cosine), angle| {
                (sine + angle.sin(), cosine + angle.cos())
            });
            let turns = sine.atan2(cosine) / std::f64::consts::TAU;
            (turns * period, sine.hypot(cosine) / grid.len() as f64)
        };
        let found = |period: f64| {
            let (counts, steady) = difference(period);
            usize::from(counts.abs() < 0.25 && steady > 0.8)
        };
        songs += 1;
        on_count += found(1.0);
        on_bar += found(4.0);
    }
    println!("of {songs} songs {on_count} on the count, {on_bar} in the bar");
    assert!(
        songs > 0 && on_count * 5 >= songs * 4,
        "{on_count} of {songs}"
    );
    assert!(on_bar * 2 >= songs, "{on_bar} of {songs}");
}
