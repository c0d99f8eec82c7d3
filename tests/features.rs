//! The feature chain against the golden vectors of librosa, stage by stage.

mod common;
#[path = "features/comparison.rs"]
mod comparison;
#[path = "features/golden.rs"]
mod golden;

use std::path::Path;

use bailando::features::{
    BEAT_COLUMN, Beats, CHROMA_COLUMNS, COLUMNS, DELTA_COLUMNS, FeatureExtractor, MFCC_COLUMNS,
    ONSET_COLUMN, Profile, Rate, TEMPOGRAM_COLUMNS,
};
use comparison::{Checked, Tolerance, frames_with_tone};
use golden::{GoldenSet, load, load_as_f32, load_vector};
use ndarray::{Array2, Axis, Slice};

/// Every clip of the golden set in the newer profile, every stage that has a file.
#[test]
fn golden_clips_of_librosa_0_11() {
    let Some(root) = common::shared("features/golden") else {
        return;
    };
    let set = GoldenSet::read(&root);
    let mut checked = Checked::default();
    for (name, clip) in set.clips() {
        let pcm = load_vector(&root.join(name).join("pcm.npy"));
        let mut extractor = FeatureExtractor::new(rate_of(clip), Profile::Librosa011);
        let stages = extractor.extract_stages(&pcm).unwrap();
        let features = &stages.features;
        let tuning = f64::from(load_as_f32(&root.join(name).join("tuning.npy"))[0]);
        let stages_of_clip = clip["stages"].as_object().unwrap();
        for (stage, about) in stages_of_clip {
            let file = root.join(about["file"].as_str().unwrap());
            let tolerance = Tolerance::of(about);
            let mut check = |got: &Array2<f32>, expected: &Array2<f32>| {
                checked.compare(stage, name, got, expected, tolerance);
            };
            match stage.as_str() {
                "pcm" => {}
                "stft_mag_40" => check(&extractor.stft_magnitudes(&pcm, 40).unwrap(), &rows(&file)),
                "mel_db" => check(&stages.mel_db, &rows(&file)),
                "mfcc" => check(&columns(features, MFCC_COLUMNS), &rows(&file)),
                "mfcc_delta" => check(&columns(features, DELTA_COLUMNS), &rows(&file)),
                "harmonic" => check(&column(&stages.harmonic), &vector(&file)),
                "percussive" => check(&column(&stages.percussive), &vector(&file)),
                "cqt_mag" => {
                    // With the golden tuning, so that a wrong one shows in its own stage only.
                    check(
                        &extractor.cqt(&stages.harmonic, tuning).unwrap(),
                        &rows(&file),
                    );
                }
                "chroma_cqt" => {
                    let frames = frames_with_tone(&stages.cqt);
                    if frames.is_empty() {
                        continue;
                    }
                    check(
                        &columns(features, CHROMA_COLUMNS).select(Axis(0), &frames),
                        &rows(&file).select(Axis(0), &frames),
                    );
                }
                "onset_env" => check(&columns(features, 52..53), &vector(&file)),
                "tempogram" => check(&columns(features, TEMPOGRAM_COLUMNS), &rows(&file)),
                "tuning" => check(&column(&[stages.tuning as f32]), &vector(&file)),
                "tempo" => check(&column(&[stages.beats.tempo_bpm as f32]), &vector(&file)),
                "beats" => check(&columns(features, 53..54), &vector(&file)),
                "features" => {
                    checked.matrix(name, features, &load(&file), &stages.cqt, &about["columns"]);
                }
                unknown => panic!("{name}: no comparison for stage {unknown}"),
            }
        }
        assert_eq!(
            stages.tuning,
            clip["tuning"].as_f64().unwrap(),
            "{name}: tuning"
        );
        check_beats(name, &stages.beats, clip);
        assert_eq!(
            stages.beats,
            extractor.beats(&pcm).unwrap(),
            "{name}: beats alone"
        );
        assert_eq!(
            *features,
            extractor.extract(&pcm).unwrap(),
            "{name}: extract"
        );
    }
    checked.report("librosa 0.11");
    assert_eq!(set.clips().len(), 14);
    let counts = |stage: &str| checked.clips(stage);
    assert_eq!(
        [
            "stft_mag_40",
            "harmonic",
            "percussive",
            "mel_db",
            "cqt_mag",
            "mfcc",
            "mfcc_delta"
        ]
        .map(counts),
        [6, 9, 9, 12, 12, 12, 12]
    );
    assert_eq!(
        [
            "chroma_cqt",
            "onset_env",
            "tempogram",
            "tuning",
            "tempo",
            "beats",
            "features"
        ]
        .map(counts),
        [12, 14, 12, 14, 14, 14, 14]
    );
}

/// Every clip in the older profile: columns 0..54, and the tempogram where there is a file.
#[test]
fn golden_clips_of_librosa_0_8_1() {
    let (Some(root), Some(inputs)) = (
        common::shared("features/golden_081"),
        common::shared("features/golden"),
    ) else {
        return;
    };
    let set = GoldenSet::read(&root);
    let mut checked = Checked::default();
    for (name, clip) in set.clips() {
        let pcm = load_vector(&inputs.join(name).join("pcm.npy"));
        let mut extractor = FeatureExtractor::new(rate_of(clip), Profile::Librosa081);
        let stages = extractor.extract_stages(&pcm).unwrap();
        let features = &stages.features;
        let expected: Array2<f32> = load(&root.join(name).join("features54.npy"));
        let limits = &clip["columns_tol"];
        let frames = frames_with_tone(&stages.cqt);
        for (stage, range, limit) in [
            ("mfcc", MFCC_COLUMNS, limits["mfcc"].as_f64().unwrap()),
            (
                "mfcc_delta",
                DELTA_COLUMNS,
                limits["mfcc_delta"].as_f64().unwrap(),
            ),
            // The bound for the decimation filter of 0.8.1 itself, which is the one used.
            ("chroma_cqt", CHROMA_COLUMNS, 1e-3),
            (
                "onset_env",
                ONSET_COLUMN..ONSET_COLUMN + 1,
                limits["onset"].as_f64().unwrap(),
            ),
            ("beats", BEAT_COLUMN..BEAT_COLUMN + 1, 0.0),
        ] {
            let (mut got, mut wanted) =
                (columns(features, range.clone()), columns(&expected, range));
            if stage == "chroma_cqt" {
                got = got.select(Axis(0), &frames);
                wanted = wanted.select(Axis(0), &frames);
            }
            checked.compare(stage, name, &got, &wanted, Tolerance::absolute(limit));
        }
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
        assert_eq!(
            stages.tuning,
            clip["tuning"].as_f64().unwrap(),
            "{name}: tuning"
        );
        check_beats(name, &stages.beats, clip);
        assert_eq!(
            *features,
            extractor.extract(&pcm).unwrap(),
            "{name}: extract"
        );
    }
    checked.report("librosa 0.8.1");
    assert_eq!(set.clips().len(), 12);
    assert_eq!(
        [
            "mfcc",
            "mfcc_delta",
            "chroma_cqt",
            "onset_env",
            "beats",
            "tempogram"
        ]
        .map(|stage| checked.clips(stage)),
        [12, 12, 12, 12, 12, 8]
    );
}

/// Beats of six whole songs at both rates, from their golden envelopes, in both profiles.
#[test]
fn golden_beats_of_whole_songs() {
    let (Some(root), Some(older)) = (
        common::shared("features/golden"),
        common::shared("features/golden_081"),
    ) else {
        return;
    };
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
            let tolerance = golden::tolerance_of(stage);
            let mut check = |got: &Array2<f32>, expected: &Array2<f32>| {
                checked.compare(stage, name, got, expected, tolerance);
            };
            match stage {
                "mel_db" => check(&stages.mel_db, &rows(&file)),
                "harmonic" => check(&column(&stages.harmonic), &vector(&file)),
                "percussive" => check(&column(&stages.percussive), &vector(&file)),
                "cqt_mag" => check(&stages.cqt, &rows(&file)),
                "onset_env" => check(&columns(&stages.features, 52..53), &vector(&file)),
                "tuning" => check(&column(&[stages.tuning as f32]), &vector(&file)),
                "tempo" => check(&column(&[stages.beats.tempo_bpm as f32]), &vector(&file)),
                "features" => {
                    let limits = golden::column_tolerances();
                    checked.matrix(name, &stages.features, &load(&file), &stages.cqt, &limits);
                }
                unknown => panic!("{name}: no comparison for stage {unknown}"),
            }
        }
        assert_eq!(
            stages.tuning,
            clip["tuning"].as_f64().unwrap(),
            "{name}: tuning"
        );
        let frames: Vec<u64> = stages
            .beats
            .frames
            .iter()
            .map(|&frame| frame as u64)
            .collect();
        assert_eq!(frames, golden::integers(&clip["beats"]), "{name}: beats");
        assert_eq!(
            stages.features,
            extractor.extract(&pcm).unwrap(),
            "{name}: extract"
        );
    }
    checked.report("our own");
    assert_eq!(set.clips().len(), 2);
    assert_eq!(
        [
            "features",
            "tuning",
            "tempo",
            "onset_env",
            "mel_db",
            "harmonic",
            "cqt_mag"
        ]
        .map(|stage| checked.clips(stage)),
        [2, 2, 2, 2, 1, 1, 1]
    );
}

fn rate_of(clip: &serde_json::Value) -> Rate {
    match clip["sr"].as_u64() {
        Some(3_840) => Rate::Conditioning,
        Some(30_720) => Rate::Beats,
        other => panic!("no such rate: {other:?}"),
    }
}

fn check_beats(name: &str, beats: &Beats, clip: &serde_json::Value) {
    let tempo = clip["tempo_bpm"].as_f64().unwrap();
    assert!(
        (beats.tempo_bpm - tempo).abs() <= 1e-5 * tempo,
        "{name}: tempo {} instead of {tempo}",
        beats.tempo_bpm
    );
    let frames: Vec<u64> = beats.frames.iter().map(|&frame| frame as u64).collect();
    assert_eq!(
        frames,
        golden::integers(&clip["beat_frames"]),
        "{name}: beats"
    );
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
