//! `music-gap`: what a model foretells with the right and with other music.

use std::fs;

use crate::testing::{TestFolder, clicks};
use bailando_testkit::model::tiny;
use bailando_train::{
    data::Split,
    encode::EncodeError,
    export::skeleton,
    held_out::Recordings,
    music_gap::{MusicGap, MusicGapOptions, music_gap},
};

/// Windows of a block of 29 that fit into 75 codes, twice, in each of three pieces.
const CODES: usize = 3 * 2 * 29;

fn measured(data: &TestFolder) -> Result<MusicGap, EncodeError> {
    let cache = tempfile::tempdir().unwrap();
    music_gap(&MusicGapOptions {
        model: tiny(),
        recordings: Recordings {
            data: data.write().to_owned(),
            audio: None,
            cache: Some(cache.path().to_owned()),
            split: Split::Train,
        },
    })
}

#[test]
fn other_music_changes_what_is_foretold() {
    let gap = measured(&TestFolder::good(&skeleton(0.93))).unwrap();
    assert_eq!((gap.pieces, gap.codes), (3, CODES));
    // Random weights: about the logarithm of the vocabulary for each half.
    assert!(gap.right_music > 1.0 && gap.right_music < 40.0, "{gap}");
    for gap in [gap.another_song, gap.one_count, gap.half_bar, gap.half_count] {
        assert!(gap.unwrap().abs() > 1e-6, "the music made no difference");
    }
    let table = gap.to_string();
    assert!(table.contains("3 pieces, 174 codes"), "{table}");
}

#[test]
fn music_that_is_the_same_everywhere_has_no_gap() {
    let data = TestFolder::good(&skeleton(0.93));
    let silence = clicks(10.0, 0.1, None);
    for song in ["a.wav", "b.wav", "c.wav"] {
        fs::write(data.path(song), &silence).unwrap();
    }
    let gap = measured(&data).unwrap();
    assert_eq!(gap.another_song, None, "there is no other song");
    for gap in [gap.one_count, gap.half_bar] {
        assert!(gap.unwrap().abs() < 1e-5, "{gap:?}");
    }
}

#[test]
fn dances_without_music_are_refused() {
    let mut data = TestFolder::good(&skeleton(0.93));
    for id in ["one_a", "one_b", "two_a"] {
        data.set(id, "audio", serde_json::Value::Null);
    }
    let refused = measured(&data).unwrap_err();
    assert!(matches!(refused, EncodeError::NoMusic), "{refused}");
}
