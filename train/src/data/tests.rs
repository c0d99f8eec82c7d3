//! Layouts, splits and music over small folders of made-up data.

use std::{fs, path::Path};

use bailando::{
    features::{BEAT_COLUMN, MFCC_COLUMNS, Profile},
    model::CountSource,
};
use ndarray::Array2;
use serde_json::json;

use super::{
    testing::{FRAMES, TestFolder, animation, clicks, dance},
    *,
};
use crate::export::skeleton;

fn open(root: &Path) -> Result<Dataset, DataError> {
    Dataset::open(root, &OpenOptions::default())
}

fn good() -> TestFolder {
    TestFolder::good(&skeleton(0.93))
}

fn song_ids<S>(dance: &Recording<S>) -> Vec<&str> {
    dance.songs().iter().map(|song| song.id.as_str()).collect()
}

#[test]
fn a_dance_comes_once_with_all_its_songs_and_in_its_own_split() {
    let folder = good();
    let data = open(folder.write()).unwrap();
    assert_eq!(data.layout, Layout::Folder);
    let training = data.training().unwrap();
    let songs: Vec<_> = training.recordings().iter().map(song_ids).collect();
    assert_eq!(songs, [vec!["one_a", "one_b"], vec!["two_a"]]);
    let evaluation = data.evaluation().unwrap();
    let songs: Vec<_> = evaluation.recordings().iter().map(song_ids).collect();
    assert_eq!(songs, [["three_a"]]);
    let expected = dance(&data.skeleton, FRAMES, 1);
    assert_eq!(training.recordings()[1].motion(&data.skeleton).unwrap().positions(), &expected);
}

#[test]
fn a_test_motion_among_the_training_pieces_stops_training() {
    let folder = good();
    fs::copy(folder.path("three.npy"), folder.path("two.npy")).unwrap();
    let data = open(folder.write()).unwrap();
    let refused = data.training().unwrap_err().to_string();
    assert!(refused.contains("`two.npy` (train) and `three.npy` (test)"), "{refused}");
}

#[test]
fn a_value_that_is_no_number_stops_training_with_file_and_frame() {
    let folder = good();
    let mut positions = dance(&skeleton(0.93), FRAMES, 0);
    positions[[17, 3, 1]] = f32::NAN;
    folder.motion("one.npy", &positions);
    let data = open(folder.write()).unwrap();
    let training = data.training().unwrap();
    let refused = training.recordings()[0].motion(&data.skeleton).unwrap_err().to_string();
    assert!(refused.ends_with("one.npy: frame 17 holds a value that is no number"), "{refused}");
}

#[test]
fn one_file_in_both_splits_stops_training_as_well() {
    let mut folder = good();
    folder.set("three_a", "motion", json!("one.npy"));
    let data = open(folder.write()).unwrap();
    assert!(matches!(data.training(), Err(DataError::Leak { .. })));
}

#[test]
fn entries_that_cannot_be_used_stop_the_trainer() {
    for (field, value, expected) in [
        ("split", json!("validation"), "split is `validation`"),
        ("split", json!(null), "has no split"),
        ("motion", json!(null), "names no motion"),
        ("frames", json!("many"), "invalid type"),
    ] {
        let mut folder = good();
        folder.set("two_a", field, value);
        let refused = open(folder.write()).unwrap_err().to_string();
        assert!(refused.contains("two_a: ") && refused.contains(expected), "{refused}");
    }
    let mut folder = good();
    folder.index["joints"] = json!(["pelvis", "spine"]);
    assert!(open(folder.write()).unwrap_err().to_string().contains("index.json"));
    let empty = tempfile::tempdir().unwrap();
    assert!(matches!(open(empty.path()), Err(DataError::Layout(_))));
}

/// A dance of the reference, 80 frames, with as many rows of music as `rows`.
fn reference_file(path: &Path, seed: u32, rows: usize) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let positions = dance(&skeleton(0.93), 80, seed);
    let flat: Vec<f32> = positions.iter().copied().collect();
    let dance: Vec<&[f32]> = flat.chunks(72).collect();
    let mut music = vec![vec![0.5; 438]; rows];
    music.iter_mut().skip(30).step_by(30).for_each(|row| row[BEAT_COLUMN] = 1.0);
    let file = json!({"id": "x", "music_array": music, "dance_array": dance});
    fs::write(path, file.to_string()).unwrap();
}

fn library(folder: &Path) -> MusicLibrary {
    let cache = FeatureCache::open(&folder.join("features")).unwrap();
    MusicLibrary::new(cache, Profile::Librosa011)
}

#[test]
fn the_references_files_are_read_with_music_of_either_rate() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    reference_file(&root.join("dance_train/gA_mX_1.json"), 4, 80);
    reference_file(&root.join("dance_train/gB_mX_2.json"), 5, 10);
    reference_file(&root.join("dance_test/gC_mY_3.json"), 6, 10);
    let data = open(root).unwrap();
    assert_eq!(data.layout, Layout::Reference);
    let training = data.training().unwrap();
    let expected = dance(&data.skeleton, 80, 4);
    assert_eq!(training.recordings()[0].motion(&data.skeleton).unwrap().positions(), &expected);
    let music: Vec<_> =
        training.recordings().iter().map(|d| d.songs()[0].music.clone().unwrap()).collect();
    let mut library = library(&root.join("cache"));
    assert_eq!(library.beats_s(&music[0]).unwrap(), [0.5, 1.0]);
    assert!(library.beats_s(&music[1]).is_err(), "rows of 7.5 a second say too little of beats");
    assert!(library.conditioning(&music[0], 0).is_err());
    assert_eq!(library.conditioning(&music[1], 0).unwrap().dim(), (10, 438));
    assert!(library.conditioning(&music[1], 1).is_err());
    assert!(!music[0].can_shift());
    assert_eq!(data.evaluation().unwrap().recordings().len(), 1);
}

#[test]
fn feature_files_of_songs_are_found_by_the_songs_name() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    reference_file(&root.join("train/gA_sB_cA_d1_mX_ch1.json"), 4, 80);
    fs::create_dir(root.join("music")).unwrap();
    let rows = json!({"music_array": vec![vec![0.25; 438]; 12]});
    fs::write(root.join("music/mX.json"), rows.to_string()).unwrap();
    let training = open(root).unwrap().training().unwrap();
    let music = training.recordings()[0].songs()[0].music.clone().unwrap();
    assert_eq!(music, MusicSource::Rows(root.join("music/mX.json")));
    let rows = library(&root.join("cache")).conditioning(&music, 0).unwrap();
    assert_eq!(rows.dim(), (12, 438));
}

#[test]
fn aist_dances_find_their_songs_and_their_splits() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("aist");
    let songs = folder.path().join("songs");
    fs::create_dir_all(root.join("motions")).unwrap();
    fs::create_dir_all(root.join("splits")).unwrap();
    fs::create_dir_all(&songs).unwrap();
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/train");
    let id = |music: &str| format!("gBR_sBM_cAll_d04_{music}_ch01");
    for (music, pickle) in [
        ("mBR0", "aist_protocol4.pkl"),
        ("mBR1", "aist_protocol4.pkl"),
        ("mBR2", "aist_float64.pkl"),
        ("mBR3", "hostile.pkl"),
    ] {
        let motion = root.join("motions").join(id(music)).with_extension("pkl");
        fs::copy(fixture.join(pickle), motion).unwrap();
    }
    fs::write(root.join("splits/crossmodal_train.txt"), id("mBR0")).unwrap();
    fs::write(root.join("splits/crossmodal_val.txt"), id("mBR2")).unwrap();
    fs::write(root.join("ignore_list.txt"), id("mBR3")).unwrap();
    fs::write(songs.join("mBR0.wav"), clicks(1.0, 0.0, Some(0.5))).unwrap();
    let options = OpenOptions { audio: Some(songs.clone()) };
    let data = Dataset::open(&root, &options).unwrap();
    assert_eq!(data.layout, Layout::Aist);
    let training = data.training().unwrap();
    let dance = &training.recordings()[0];
    assert_eq!(training.recordings().len(), 1, "mBR1 is in no list");
    assert_eq!(dance.songs()[0].music, Some(MusicSource::Audio(songs.join("mBR0.wav"))));
    assert_eq!(dance.motion(training.skeleton()).unwrap().frames(), 12);
    assert_eq!(data.evaluation().unwrap().recordings().len(), 1);
}

#[test]
fn a_song_is_computed_once_and_again_when_its_entry_is_damaged() {
    let folder = good();
    let song = MusicSource::Audio(folder.path("a.wav"));
    let root = folder.write();
    let mut first = library(root);
    let rows = first.conditioning(&song, 0).unwrap();
    assert_eq!(rows.dim(), (1 + 38_400 / 512, 438));
    assert_eq!((first.conditioning(&song, 0).unwrap(), first.computed()), (rows.clone(), 1));
    let mut second = library(root);
    assert_eq!((second.conditioning(&song, 0).unwrap(), second.computed()), (rows.clone(), 0));
    let entry = fs::read_dir(root.join("features")).unwrap().next().unwrap().unwrap().path();
    let mut bytes = fs::read(&entry).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    fs::write(&entry, bytes).unwrap();
    assert_eq!((second.conditioning(&song, 0).unwrap(), second.computed()), (rows, 1));
}

/// Largest difference of the MFCC of some rows.
fn mfcc_difference(a: &Array2<f32>, b: &Array2<f32>, from: usize, later: usize) -> f32 {
    let rows = from..a.nrows().min(b.nrows() - later) - 4;
    let cells = rows.flat_map(|row| MFCC_COLUMNS.map(move |column| (row, column)));
    cells
        .map(|(row, column)| (a[[row, column]] - b[[row + later, column]]).abs())
        .fold(0.0, f32::max)
}

#[test]
fn music_moves_with_the_start_phase() {
    let folder = good();
    let song = folder.path("a.wav");
    let source = MusicSource::Audio(song.clone());
    let mut library = library(folder.write());
    let whole = library.conditioning(&source, 0).unwrap();
    // 8 frames are one row: the same rows, one earlier.
    let one_row = library.conditioning(&source, 8).unwrap();
    assert!(mfcc_difference(&one_row, &whole, 4, 1) < 0.02);
    // 3 frames are 800 samples of the file at 16 kHz.
    let cut = library.conditioning(&source, 3).unwrap();
    assert!(mfcc_difference(&cut, &whole, 4, 0) > 1.0);
    let bytes = fs::read(&song).unwrap();
    let (header, samples) = bytes.split_at(44);
    let size = u32::try_from(samples.len() - 1_600).unwrap().to_le_bytes();
    let file = [&header[..40], &size, &samples[1_600..]].concat();
    let shorter = folder.path("shorter.wav");
    fs::write(&shorter, file).unwrap();
    let expected = library.conditioning(&MusicSource::Audio(shorter), 0).unwrap();
    assert!(mfcc_difference(&cut, &expected, 4, 0) < 0.02);
    let phases = library.phases(&source, 4).unwrap();
    assert_eq!((&phases[0], &phases[3]), (&whole, &cut));
}

#[test]
fn counts_follow_the_features_of_every_phase() {
    let folder = good();
    let song = MusicSource::Audio(folder.path("a.wav"));
    let plain = library(folder.write()).phases(&song, 4).unwrap();
    let mut counting = library(folder.write()).with_count_periods(&[1, 4], CountSource::Librosa);
    let rows = counting.phases(&song, 4).unwrap();
    for (rows, plain) in rows.iter().zip(&plain) {
        assert_eq!(rows.dim(), (plain.nrows(), 442));
        assert_eq!(rows.slice_axis(ndarray::Axis(1), ndarray::Slice::from(..438)), plain);
        for row in rows.rows() {
            for pair in [438, 440] {
                let length = row[pair].hypot(row[pair + 1]);
                assert!((length - 1.0).abs() < 1e-5, "no angle: {length}");
            }
        }
    }
    assert_eq!(counting.conditioning(&song, 3).unwrap(), rows[3]);
    // Clicks every half second from 0.1 s on: rows of 8 frames a second later are at the same
    // place.
    let angle = |phase: usize, row: usize| rows[phase][[row, 438]].atan2(rows[phase][[row, 439]]);
    let turn = (angle(3, 30) - angle(0, 30)).rem_euclid(std::f32::consts::TAU);
    let counts = 3.0 / 60.0 / 0.25;
    assert!((turn - counts * std::f32::consts::TAU).abs() < 0.5, "{turn}");

    let stored = MusicSource::Rows(folder.path("stored.json"));
    let refused = counting.conditioning(&stored, 0).unwrap_err();
    assert!(matches!(refused, DataError::StoredRows { .. }), "{refused}");
}

#[test]
fn counts_that_the_data_say_take_the_place_of_tracked_ones() {
    let folder = good();
    let song = MusicSource::Audio(folder.path("a.wav"));
    let data = open(folder.write()).unwrap();
    let training = data.training().unwrap();
    let known: KnownCounts = training
        .recordings()
        .iter()
        .flat_map(Recording::known_counts)
        .map(|(music, counts)| (music.clone(), counts))
        .collect();
    let mut library = library(folder.write())
        .with_count_periods(&[8], CountSource::Librosa)
        .with_known_counts(known.into());
    let rows = library.conditioning(&song, 0).unwrap();
    // Beats every half second from 0.1 s on: two counts each, the first of a phrase at 0.1 s.
    let counts = (0.4 - 0.1) / 0.25;
    let wanted = std::f32::consts::TAU * counts / 8.0;
    let angle = rows[[3, 438]].atan2(rows[[3, 439]]);
    assert!((angle - wanted).abs() < 1e-4, "{angle} {wanted}");
}

#[test]
fn the_synthetic_figure_is_a_person_on_our_skeleton() {
    let skeleton = skeleton(0.93);
    let joints = skeleton.joints.len();
    assert_eq!(animation(joints, 3, 0).rotations.len(), 3);
    assert_eq!(dance(&skeleton, 3, 0).dim(), (3, JOINTS, 3));
}
