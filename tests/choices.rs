//! Choices between motions: segments generated again, codes that are never drawn.

use bailando::{
    audio::AudioRange,
    engine::{GenerationOptions, GenerationRequest},
    formats::Codes,
};
use bailando_testkit::song;

use crate::support::{TINY, dance_to, music};

fn options(seed: u64, temperature: f32, redo: bool) -> GenerationOptions {
    GenerationOptions {
        seed: Some(seed),
        temperature: Some(temperature),
        redo: Some(redo),
        range: AudioRange { offset_s: 0.0, duration_s: Some(10.0) },
        ..GenerationOptions::default()
    }
}

#[test]
fn a_dance_with_regenerated_phrases_repeats_itself() {
    let codes = |seed, temperature, redo| {
        dance_to(&TINY, song("demo.ogg"), &options(seed, temperature, redo)).codes
    };
    let regenerated = codes(1, 0.85, true);
    assert_eq!(regenerated, codes(1, 0.85, true));
    assert_ne!(regenerated, codes(2, 0.85, true));
    // Each phrase has random numbers of its own then.
    assert_ne!(regenerated, codes(1, 0.85, false));
    // The most likely codes are the same however often they are asked for.
    assert_eq!(codes(1, 0.0, true), codes(1, 0.0, false));
}

#[test]
fn what_returns_in_a_song_returns_in_its_dance() {
    let codes = |form| {
        let range = AudioRange::default();
        let options = GenerationOptions { form, range, ..options(1, 0.85, false) };
        let Codes { upper, lower } = dance_to(&TINY, song("demo.ogg"), &options).codes;
        upper.into_iter().zip(lower).collect::<Vec<_>>()
    };
    // Most codes in a row that are those of five seconds or more before.
    let repeated = |codes: &[(u32, u32)]| {
        let longest = |lag: usize| {
            let is_same = |at: usize| codes[at] == codes[at - lag];
            let runs = (lag..codes.len()).scan(0, |run, at| {
                *run = if is_same(at) { *run + 1 } else { 0 };
                Some(*run)
            });
            runs.max().unwrap_or(0)
        };
        (38..codes.len()).map(longest).max()
    };
    let free = codes(None);
    assert!(repeated(&free) < Some(8), "{:?}", repeated(&free));
    assert_eq!(free, codes(Some(false)));
    // Two phrases of eight counts, 2.3 s each.
    let formed = codes(Some(true));
    assert!(repeated(&formed) >= Some(34), "{:?}", repeated(&formed));
}

#[test]
fn suppressed_codes_are_never_drawn() {
    let suppressed = &TINY.manifest().suppressed_codes;
    assert!(!suppressed.upper.is_empty() && !suppressed.lower.is_empty());
    for seed in 0..4 {
        // So hot that every other code is drawn.
        let music = music(300, TINY.manifest().features.columns);
        let request = GenerationRequest::features(music, options(seed, 10.0, false));
        let Codes { upper, lower } = TINY.generate(request).unwrap().codes;
        for (drawn, suppressed) in [(upper, &suppressed.upper), (lower, &suppressed.lower)] {
            for code in 0..16 {
                let is_drawn = drawn.contains(&code);
                assert_eq!(is_drawn, !suppressed.contains(&code), "code {code}, seed {seed}");
            }
        }
    }
}
