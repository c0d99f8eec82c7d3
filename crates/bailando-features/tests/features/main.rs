//! The feature chain against the golden vectors of librosa, stage by stage.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail loudly and report what they measured"
)]

mod comparison;
mod counts;
mod golden;

use std::{collections::BTreeMap, ops::Range, path::Path};

use bailando_features::{
    BEAT_COLUMN, CHROMA_COLUMNS, COLUMNS, DELTA_COLUMNS, FeatureExtractor, MFCC_COLUMNS,
    ONSET_COLUMN, Profile, Rate, Stages, TEMPOGRAM_COLUMNS,
};
use comparison::{Checked, Tolerance, frames_with_tone};
use golden::{GoldenSet, load, load_as_f32, load_vector};
use ndarray::{Array2, Axis, Slice};
use serde_json::Value;

/// A clip of a golden set, and the chain's results for it.
struct Clip<'a> {
    name: &'a str,
    about: &'a Value,
    pcm: Vec<f32>,
    extractor: FeatureExtractor,
    stages: Stages,
}

impl<'a> Clip<'a> {
    fn new(name: &'a str, about: &'a Value, folder: &Path, profile: Profile) -> Self {
        let pcm = load_vector(&folder.join(name).join("pcm.npy"));
        let mut extractor = FeatureExtractor::new(rate_of(about), profile);
        let stages = extractor.extract_stages(&pcm).unwrap();
        Self { name, about, pcm, extractor, stages }
    }

    /// Compares one stage with its file.
    fn compare(&mut self, checked: &mut Checked, stage: &str, file: &Path, tolerance: Tolerance) {
        let stages = &self.stages;
        let (mut got, mut expected) = match stage {
            "stft_mag_40" => {
                let got = self.extractor.stft_magnitudes(&self.pcm, 40);
                (got.unwrap(), rows(file))
            }
            "mel_db" => (stages.mel_db.clone(), rows(file)),
            "harmonic" => (column(&stages.harmonic), vector(file)),
            "percussive" => (column(&stages.percussive), vector(file)),
            "tuning" => (column(&[stages.tuning as f32]), vector(file)),
            // With the golden tuning, so that a wrong one shows in its own stage only.
            "cqt_mag" => {
                let tuning = self.about["tuning"].as_f64().unwrap();
                let got = self.extractor.cqt(&stages.harmonic, tuning);
                (got.unwrap(), rows(file))
            }
            "tempo" => (column(&[stages.beats.tempo_bpm as f32]), vector(file)),
            _ => {
                let (range, is_vector) = columns_of(stage);
                let expected = if is_vector { vector(file) } else { rows(file) };
                (columns(&stages.features, range), expected)
            }
        };
        if stage == "chroma_cqt" {
            let frames = frames_with_tone(&stages.cqt);
            got = got.select(Axis(0), &frames);
            expected = expected.select(Axis(0), &frames);
        }
        checked.compare(stage, self.name, &got, &expected, tolerance);
    }

    /// Compares the feature matrix with a file.
    fn compare_matrix(&self, checked: &mut Checked, file: &Path, groups: &Value) {
        let Stages { features, cqt, .. } = &self.stages;
        checked.matrix(self.name, features, &load(file), cqt, groups);
    }

    /// Checks tuning, tempo and beats against the index, and that shorter ways to a result give the
    /// same.
    fn check_numbers(&mut self, tempo: &str, beats: &str) {
        let (name, about, stages) = (self.name, self.about, &self.stages);
        // Exact: tunings are multiples of 0.01, and reading them from JSON may cost the last bit.
        let tuning = about["tuning"].as_f64().unwrap();
        let got = stages.tuning;
        assert!((got - tuning).abs() < 1e-12, "{name}: tuning {got}, {tuning}");
        let (got, tempo) = (stages.beats.tempo_bpm, about[tempo].as_f64().unwrap());
        assert!((got - tempo).abs() <= 1e-5 * tempo, "{name}: tempo {got}, {tempo}");
        let expected: Vec<usize> = serde_json::from_value(about[beats].clone()).unwrap();
        assert_eq!(stages.beats.frames, expected, "{name}: beats");

        let features = self.extractor.extract(&self.pcm).unwrap();
        assert_eq!(stages.features, features, "{name}: extract");
        let beats = self.extractor.beats(&self.pcm).unwrap();
        assert_eq!(stages.beats, beats, "{name}: beats");
    }
}

/// Every clip of the golden set in the newer profile, every stage that has a file.
#[test]
fn golden_clips_of_librosa_0_11() {
    let Some(root) = bailando_testkit::shared("features/golden") else {
        return;
    };
    let set = GoldenSet::read(&root);
    let mut checked = Checked::default();
    for (name, about) in set.clips() {
        let mut clip = Clip::new(name, about, &root, Profile::Librosa011);
        for (stage, details) in about["stages"].as_object().unwrap() {
            let file = root.join(details["file"].as_str().unwrap());
            match stage.as_str() {
                "pcm" => {
                    let samples = details["shape"][0].as_u64().unwrap();
                    assert_eq!(clip.pcm.len() as u64, samples);
                }
                "features" => clip.compare_matrix(&mut checked, &file, &details["columns"]),
                _ => clip.compare(&mut checked, stage, &file, Tolerance::of(details)),
            }
        }
        clip.check_numbers("tempo_bpm", "beat_frames");
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
    for (name, about) in set.clips() {
        let mut clip = Clip::new(name, about, &inputs, Profile::Librosa081);
        let Stages { features, cqt, .. } = &clip.stages;
        let expected = load(&root.join(name).join("features54.npy"));
        compare_first_columns(&mut checked, name, (features, cqt), &expected, about);
        if about["onset_all_zero"].as_bool().unwrap() {
            let rhythm = columns(features, 52..COLUMNS);
            assert!(rhythm.iter().all(|&x| x == 0.0), "{name}");
        }
        if about.get("tempogram").is_some() {
            let file = root.join(name).join("tempogram.npy");
            clip.compare(&mut checked, "tempogram", &file, Tolerance::absolute(2e-4));
        }
        clip.check_numbers("tempo_bpm", "beat_frames");
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
    (features, cqt): (&Array2<f32>, &Array2<f32>),
    expected: &Array2<f32>,
    about: &Value,
) {
    assert_eq!(expected.dim(), (features.nrows(), 54));
    for (stage, limit) in [
        ("mfcc", Some("mfcc")),
        ("mfcc_delta", Some("mfcc_delta")),
        ("chroma_cqt", None),
        ("onset_env", Some("onset")),
        ("beats", Some("beats")),
    ] {
        // Chroma: the bound for the decimation filter of 0.8.1 itself, which is the one used.
        let limit = limit.map_or(1e-3, |key| about["columns_tol"][key].as_f64().unwrap());
        let frames = match stage {
            "chroma_cqt" => frames_with_tone(cqt),
            _ => (0..expected.nrows()).collect(),
        };
        let (range, _) = columns_of(stage);
        let select = |matrix: &Array2<f32>| columns(matrix, range.clone()).select(Axis(0), &frames);
        let tolerance = Tolerance::absolute(limit);
        checked.compare(stage, clip, &select(features), &select(expected), tolerance);
    }
}

/// Beats of six whole songs at both rates, from their golden envelopes, in both profiles.
#[test]
fn golden_beats_of_whole_songs() {
    let Some(shared) = bailando_testkit::shared("features") else {
        return;
    };
    let (root, older) = (shared.join("golden"), shared.join("golden_081"));
    let songs: BTreeMap<_, _> = GoldenSet::read(&root).beats_only();
    let songs_of_older = GoldenSet::read(&older).beats_only();
    assert_eq!((songs.len(), songs_of_older.len()), (6, 6));
    for (name, song) in &songs {
        let folder = root.join(song["dir"].as_str().unwrap());
        let onset = load_vector(&folder.join("onset_env.npy"));
        assert_eq!(onset.len() as u64, song["n_frames"].as_u64().unwrap());
        let song_of_older = &songs_of_older[name];
        let file = older.join(song_of_older["file"].as_str().unwrap());
        let tempo = f64::from(load_as_f32(&folder.join("tempo.npy"))[0]);
        let tempo_of_older = song_of_older["tempo_bpm"].as_f64().unwrap();
        for (profile, about, file, tempo) in [
            (Profile::Librosa011, song, folder.join("beat_frames.npy"), tempo),
            (Profile::Librosa081, song_of_older, file, tempo_of_older),
        ] {
            let frames = load::<i32, ndarray::Ix1>(&file);
            let expected: Vec<usize> = frames.iter().map(|&frame| frame as usize).collect();
            assert_eq!(expected.len() as u64, about["n_beats"].as_u64().unwrap());
            let beats = FeatureExtractor::new(rate_of(song), profile).beats_of_onset(&onset);
            let ratio = beats.tempo_bpm / tempo;
            assert!((ratio - 1.0).abs() < 1e-6, "{name}: tempo, {profile:?}");
            assert_eq!(beats.frames, expected, "{name}, {profile:?}");
        }
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
    let root = bailando_testkit::fixture("features");
    let set = GoldenSet::read(&root);
    let mut checked = Checked::default();
    for (name, about) in set.clips() {
        let mut clip = Clip::new(name, about, &root, Profile::Librosa011);
        let number = |key: &str| about[key].as_u64().unwrap();
        assert_eq!(clip.pcm.len() as u64, number("samples"));
        assert_eq!(clip.stages.features.nrows() as u64, number("frames"));
        for stage in about["files"].as_array().unwrap() {
            let stage = stage.as_str().unwrap();
            let file = root.join(name).join(format!("{stage}.npy"));
            match stage {
                "features" => {
                    clip.compare_matrix(&mut checked, &file, &golden::column_tolerances());
                }
                _ => clip.compare(&mut checked, stage, &file, golden::tolerance_of(stage)),
            }
        }
        clip.check_numbers("tempo", "beats");
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

fn rate_of(clip: &Value) -> Rate {
    match clip["sr"].as_u64() {
        Some(3_840) => Rate::Conditioning,
        Some(30_720) => Rate::Beats,
        other => panic!("no such rate: {other:?}"),
    }
}

/// Columns of the stages that are columns of the matrix, and whether their files are vectors.
fn columns_of(stage: &str) -> (Range<usize>, bool) {
    match stage {
        "mfcc" => (MFCC_COLUMNS, false),
        "mfcc_delta" => (DELTA_COLUMNS, false),
        "chroma_cqt" => (CHROMA_COLUMNS, false),
        "onset_env" => (ONSET_COLUMN..ONSET_COLUMN + 1, true),
        "beats" => (BEAT_COLUMN..BEAT_COLUMN + 1, true),
        "tempogram" => (TEMPOGRAM_COLUMNS, false),
        unknown => panic!("no comparison for stage {unknown}"),
    }
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

fn columns(matrix: &Array2<f32>, range: Range<usize>) -> Array2<f32> {
    matrix.slice_axis(Axis(1), Slice::from(range)).to_owned()
}
