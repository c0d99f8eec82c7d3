//! Each defect, made on purpose, is found and named, and nothing else with it.

use std::fs;

use bailando::motion::Positions;
use serde_json::json;

use super::*;
use crate::{
    data::{
        OpenOptions,
        testing::{FRAMES, TestFolder, clicks, dance},
    },
    export::skeleton,
};

/// Options without songs, for the tests of motion.
const WITHOUT_SONGS: CheckOptions =
    CheckOptions { open: OpenOptions { audio: None }, songs: Some(0), beats: 0 };

fn good() -> TestFolder {
    TestFolder::good(&skeleton(0.93))
}

fn figure() -> Positions {
    dance(&skeleton(0.93), FRAMES, 0)
}

fn report(folder: &TestFolder, options: &CheckOptions) -> Report {
    check(folder.write(), options).unwrap()
}

/// The only finding, and its only place.
#[track_caller]
fn only(report: &Report, topic: Topic) -> String {
    let topics: Vec<Topic> = report.findings.iter().map(|finding| finding.topic).collect();
    assert_eq!(topics, [topic], "{report}");
    let places = &report.findings[0].places;
    assert_eq!(places.len(), 1, "{report}");
    assert_eq!(report.is_usable(), topic.severity() != Severity::Unusable);
    places[0].clone()
}

/// What a change of dance one gives.
#[track_caller]
fn spoiled(topic: Topic, change: impl Fn(&mut Positions)) -> String {
    let folder = good();
    let mut positions = figure();
    change(&mut positions);
    folder.motion("one.npy", &positions);
    only(&report(&folder, &WITHOUT_SONGS), topic)
}

/// As [`spoiled`], for a change of single points.
#[track_caller]
fn moved(topic: Topic, change: impl Fn([f32; 3]) -> [f32; 3]) -> String {
    spoiled(topic, |positions| {
        for mut pose in positions.outer_iter_mut() {
            for mut point in pose.outer_iter_mut() {
                let turned = change([point[0], point[1], point[2]]);
                for (cell, value) in point.iter_mut().zip(turned) {
                    *cell = value;
                }
            }
        }
    })
}

#[test]
fn a_good_folder_has_no_findings() {
    let report = report(&good(), &CheckOptions::default());
    assert!(report.findings.is_empty(), "{report}");
    assert_eq!((report.songs_decoded, report.beats_compared), (4, 4));
    let [train, test] = &report.splits[..] else {
        panic!("two splits");
    };
    assert_eq!((train.pieces, train.dances, train.songs), (3, 2, 3));
    assert_eq!((test.pieces, test.dances, test.songs), (1, 1, 1));
    assert!((train.minutes - 0.5).abs() < 1e-9 && (train.dance_minutes - 1.0 / 3.0).abs() < 1e-9);
}

#[test]
fn units_are_named_with_the_factor() {
    let place = moved(Topic::Units, |point| point.map(|value| 100.0 * value));
    assert!(place.contains("centimetres; factor 0.0100"), "{place}");
    let place = moved(Topic::Units, |point| point.map(|value| 1_000.0 * value));
    assert!(place.contains("millimetres; factor 0.0010"), "{place}");
    let place = moved(Topic::Units, |point| point.map(|value| 39.37 * value));
    assert!(place.contains("inches"), "{place}");
    let place = moved(Topic::Units, |point| point.map(|value| 7.0 * value));
    assert!(place.contains("7.000 times"), "{place}");
}

#[test]
fn a_root_in_centimetres_over_a_body_in_metres_is_found() {
    let place = spoiled(Topic::RootUnits, |positions| {
        for mut pose in positions.outer_iter_mut() {
            for axis in 0..3 {
                let shift = 99.0 * pose[[0, axis]];
                pose.column_mut(axis).mapv_inplace(|value| value + shift);
            }
        }
    });
    assert!(place.contains("height 9"), "{place}");
}

#[test]
fn axes_are_told_by_where_the_head_is() {
    let place = moved(Topic::Axes, |[x, y, z]| [x, -z, y]);
    assert!(place.contains("from feet to head is +z"), "{place}");
    let place = moved(Topic::Axes, |[x, y, z]| [-x, -y, z]);
    assert!(place.contains("is -y"), "{place}");
    let place = moved(Topic::Axes, |[x, y, z]| [y, -x, z]);
    assert!(place.contains("is +x"), "{place}");
}

#[test]
fn exchanged_sides_are_suspected() {
    // A left-handed system looks the same.
    let place = moved(Topic::Sides, |[x, y, z]| [-x, y, z]);
    assert!(place.contains("100 %"), "{place}");
}

#[test]
fn bones_must_keep_their_length_and_the_skeletons() {
    let folder = good();
    let mut positions = figure();
    for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
        pose[[15, 1]] += 0.03 * (frame as f32 / 9.0).sin();
    }
    folder.motion("one.npy", &positions);
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::BonesVary);
    assert!(place.starts_with("one.npy: the bone to head"), "{place}");
    // A child: every bone a quarter shorter, and the floor still at 0.
    let place = moved(Topic::BonesDiffer, |point| point.map(|value| 0.75 * value));
    assert!(place.contains("cm"), "{place}");
}

#[test]
fn broken_numbers_and_jumps_are_found_with_their_frame() {
    let place = spoiled(Topic::NotFinite, |positions| positions[[17, 3, 1]] = f32::NAN);
    assert_eq!(place, "one.npy: first in frame 17");
    let place = spoiled(Topic::Jumps, |positions| {
        for mut pose in positions.outer_iter_mut().skip(200) {
            pose.column_mut(0).mapv_inplace(|x| x + 2.0);
        }
    });
    assert!(place.contains("m/s in frame 200"), "{place}");
}

#[test]
fn stretched_and_frozen_motion_is_found() {
    let place = spoiled(Topic::FrameRate, |positions| {
        let source = positions.clone();
        for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
            pose.assign(&source.index_axis(ndarray::Axis(0), frame / 2 * 2));
        }
    });
    assert!(place.contains("as if 30 a second"), "{place}");
    let place = spoiled(Topic::Still, |positions| {
        let source = positions.clone();
        let first = source.index_axis(ndarray::Axis(0), 0);
        for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
            pose.assign(&first);
            pose.column_mut(2).mapv_inplace(|z| z + frame as f32 * 1e-4);
        }
    });
    assert!(place.contains("cm/s"), "{place}");
}

#[test]
fn the_floor_is_judged_by_the_standing_foot() {
    let place = moved(Topic::Floor, |[x, y, z]| [x, y + 0.23, z]);
    assert_eq!(place, "one.npy: 25 cm above it");
}

#[test]
fn lengths_must_agree() {
    let mut folder = good();
    folder.set("two_a", "frames", json!(599));
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::DeclaredLength);
    assert_eq!(place, "two_a: frames 599 in the index, 600 in two.npy");
    let mut folder = good();
    folder.set("two_a", "seconds", json!(20.0));
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::DeclaredLength);
    assert!(place.contains("30.0 a second would fit"), "{place}");
    let mut folder = good();
    folder.set("two_a", "fps", json!(30));
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::FrameRate);
    assert_eq!(place, "two_a: the index says fps 30");
    let folder = good();
    folder.motion("two.npy", &dance(&skeleton(0.93), 200, 1));
    let report = report(&folder, &WITHOUT_SONGS);
    let topics: Vec<_> = report.findings.iter().map(|finding| finding.topic).collect();
    assert_eq!(topics, [Topic::DeclaredLength, Topic::Short]);
}

#[test]
fn missing_and_broken_files_are_named() {
    let folder = good();
    fs::remove_file(folder.path("d.wav")).unwrap();
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::MissingFile);
    assert_eq!(place, "three_a: d.wav");
    let folder = good();
    fs::write(folder.path("two.npy"), "not numbers").unwrap();
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::MotionFile);
    assert!(place.contains("two.npy: this is no whole .npy file"), "{place}");
    let folder = good();
    fs::write(folder.path("c.wav"), "not music").unwrap();
    let place = only(&report(&folder, &CheckOptions::default()), Topic::AudioFile);
    assert!(place.contains("c.wav"), "{place}");
    let mut folder = good();
    folder.set("two_a", "split", json!("dev"));
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::Entry);
    assert!(place.contains("two_a: split is `dev`"), "{place}");
}

#[test]
fn songs_are_listened_to() {
    let check_song = |topic, song: Vec<u8>| {
        let folder = good();
        fs::write(folder.path("c.wav"), song).unwrap();
        only(&report(&folder, &CheckOptions::default()), topic)
    };
    assert_eq!(check_song(Topic::Silent, clicks(10.0, 0.0, None)), "c.wav");
    let place = check_song(Topic::AudioLength, clicks(8.0, 0.1, Some(0.48)));
    assert_eq!(place, "two_a: the dance lasts 10.00 s, the song 8.00 s");
    let place = check_song(Topic::FrameRate, clicks(20.0, 0.1, Some(0.48)));
    assert!(place.contains("30 frames a second would fit"), "{place}");
    let place = check_song(Topic::GridOffset, clicks(10.0, 0.26, Some(0.48)));
    assert!(
        place.contains("two_a with c.wav: the grid is 1") && place.ends_with("early"),
        "{place}"
    );
    let place = check_song(Topic::Grid, clicks(10.0, 0.1, Some(0.56)));
    assert!(place.contains("two_a with c.wav"), "{place}");
}

#[test]
fn leaks_and_duplicates_are_found_by_content() {
    let folder = good();
    fs::copy(folder.path("three.npy"), folder.path("two.npy")).unwrap();
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::Leak);
    assert_eq!(place, "train: two.npy; test: three.npy");
    let folder = good();
    fs::copy(folder.path("one.npy"), folder.path("two.npy")).unwrap();
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::Duplicate);
    assert_eq!(place, "one.npy, two.npy: the same content");
    let mut folder = good();
    folder.set("three_a", "audio", json!("a.wav"));
    folder.set("three_a", "grid_beats_s", json!([]));
    let place = only(&report(&folder, &CheckOptions::default()), Topic::SharedSong);
    assert_eq!(place, "train: a.wav; test: a.wav");
    let mut folder = good();
    folder.set("one_a", "source", json!("take 5"));
    folder.set("three_a", "source", json!("take 5"));
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::SharedRecording);
    assert_eq!(place, "take 5: train: one.npy; test: three.npy");
    let mut folder = good();
    folder.set("one_b", "audio", json!("a.wav"));
    let place = only(&report(&folder, &WITHOUT_SONGS), Topic::Duplicate);
    assert!(place.contains("one_a and one_b"), "{place}");
    let mut folder = good();
    folder.set("two_a", "id", json!("one_a"));
    assert_eq!(only(&report(&folder, &WITHOUT_SONGS), Topic::DuplicateId), "one_a: 2 times");
}

#[test]
fn splits_must_not_be_empty() {
    let mut folder = good();
    folder.set("three_a", "split", json!("train"));
    only(&report(&folder, &WITHOUT_SONGS), Topic::NoTest);
    let mut folder = good();
    for id in ["one_a", "one_b", "two_a"] {
        folder.set(id, "split", json!("test"));
    }
    only(&report(&folder, &WITHOUT_SONGS), Topic::NoTraining);
    let mut folder = good();
    folder.set("two_a", "audio", json!(null));
    assert_eq!(only(&report(&folder, &WITHOUT_SONGS), Topic::NoMusic), "1 of 4 pieces");
}

#[test]
fn dances_that_lists_name_in_vain_are_counted_for_each_split() {
    let folder = tempfile::tempdir().unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/train");
    fs::copy(fixtures.join("aist_protocol4.pkl"), folder.path().join("a.pkl")).unwrap();
    fs::create_dir(folder.path().join("splits")).unwrap();
    for (name, ids) in [
        ("splits/crossmodal_train.txt", "a b c"),
        ("splits/crossmodal_val.txt", "d e f"),
        ("splits/crossmodal_test.txt", "g"),
        ("ignore_list.txt", "c"),
    ] {
        fs::write(folder.path().join(name), ids.replace(' ', "\n")).unwrap();
    }
    let report = check(folder.path(), &WITHOUT_SONGS).unwrap();
    let absent = report.findings.iter().find(|finding| finding.topic == Topic::Absent).unwrap();
    assert_eq!(absent.places, ["train: 1 of 2: b", "test: 4 of 4: d, e, f, .."]);
    assert_eq!(absent.severity, Severity::Warning);
}

#[test]
fn songs_are_picked_evenly_and_exactly() {
    for (wanted, count) in [(0, 5), (2, 5), (5, 5), (9, 5), (3, 0)] {
        let picked = (0..count).filter(|&index| music::is_picked(index, wanted, count));
        assert_eq!(picked.count(), wanted.min(count));
    }
}

#[test]
fn the_references_files_are_checked_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, rows: usize| {
        let flat: Vec<f32> = dance(&skeleton(0.93), 300, 1).iter().copied().collect();
        let dance: Vec<&[f32]> = flat.chunks(72).collect();
        let music = vec![vec![0.5; 438]; rows];
        let file = json!({"id": name, "music_array": music, "dance_array": dance});
        fs::write(folder.path().join(name), file.to_string()).unwrap();
    };
    write("a.json", 300);
    let report = check(folder.path(), &WITHOUT_SONGS).unwrap();
    let topics: Vec<_> = report.findings.iter().map(|finding| finding.topic).collect();
    assert_eq!(topics, [Topic::StoredRows, Topic::NoTest, Topic::Layout]);
    write("a.json", 37);
    let report = check(folder.path(), &WITHOUT_SONGS).unwrap();
    let topics: Vec<_> = report.findings.iter().map(|finding| finding.topic).collect();
    assert_eq!(topics, [Topic::NoTest, Topic::Layout]);
    write("a.json", 150);
    let report = check(folder.path(), &WITHOUT_SONGS).unwrap();
    assert_eq!(report.findings[0].topic, Topic::AudioFile);
    assert!(report.findings[0].places[0].contains("150 rows of music beside 300 frames"));
}

#[test]
fn aist_motions_are_checked_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/train");
    for name in ["aist_protocol4.pkl", "hostile.pkl"] {
        fs::copy(fixtures.join(name), folder.path().join(name)).unwrap();
    }
    let report = check(folder.path(), &WITHOUT_SONGS).unwrap();
    let topics: Vec<_> = report.findings.iter().map(|finding| finding.topic).collect();
    assert!(topics.contains(&Topic::Short) && topics.contains(&Topic::NoTraining), "{report}");
    assert_eq!(report.findings[0].topic, Topic::MotionFile);
    assert!(report.findings[0].places[0].contains("`posix.system`"), "{report}");
    assert!(!report.is_usable());
}
