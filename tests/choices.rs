//! Choices between motions: candidates, segments generated again, codes that are never drawn.

#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "helpers of tests: failing loudly is their job"
)]

#[path = "common/demo.rs"]
mod demo;

use bailando::{
    engine::GenerationOptions,
    evaluation::{Motion, speed},
    formats::GeneratedMotion,
    motion::{beat_align_score, dance_beats, slow_share},
};
use bailando_testkit::song as fixture;
use bailando_testkit::wav::wav16;
use demo::{dance_to, engine};

const FPS: f64 = 60.0;

/// The demo song danced to.
fn dance(options: &GenerationOptions) -> GeneratedMotion {
    dance_to(fixture("demo.ogg"), options)
}

/// Metres that the mean joint moves from each frame to the next.
fn speeds(dance: &GeneratedMotion) -> Vec<f64> {
    let motion = Motion::new("demo", dance.positions.view()).unwrap();
    speed(motion.poses())
}

/// Mean nearness of the demo song's beats to the dance's (Eq. 15), over a few seeds.
fn beat_score(candidates: usize) -> f64 {
    const SEEDS: std::ops::Range<u64> = 0..8;
    let scores = SEEDS.map(|seed| {
        let dance = dance(&GenerationOptions {
            seed: Some(seed),
            candidates: Some(candidates),
            music: true,
            ..GenerationOptions::default()
        });
        let beats = &dance.music.as_ref().unwrap().beats_s;
        let music: Vec<usize> =
            beats.iter().map(|second| (second * FPS).round() as usize).collect();
        beat_align_score(&music, &dance_beats(&speeds(&dance)))
    });
    scores.sum::<f64>() / SEEDS.count() as f64
}

#[test]
fn of_several_candidates_those_on_the_beat_are_danced() {
    let (one, six) = (beat_score(1), beat_score(6));
    println!("beat score {one:.3} of one candidate, {six:.3} of six");
    assert!(six > one + 0.03, "{one} {six}");
}

fn redo(seed: u64, temperature: f32, redo: bool) -> GenerationOptions {
    GenerationOptions {
        seed: Some(seed),
        temperature: Some(temperature),
        redo: Some(redo),
        ..GenerationOptions::default()
    }
}

#[test]
fn a_dance_that_may_be_danced_anew_repeats_itself() {
    let codes = |seed, temperature, anew| dance(&redo(seed, temperature, anew)).codes;
    let anew = codes(1, 0.85, true);
    assert_eq!(anew, codes(1, 0.85, true));
    assert_ne!(anew, codes(2, 0.85, true));
    // Each phrase has random numbers of its own then.
    assert_ne!(anew, codes(1, 0.85, false));
    // The most likely codes are the same however often they are asked for.
    assert_eq!(codes(1, 0.0, true), codes(1, 0.0, false));
}

#[test]
fn what_is_danced_anew_stands_still_less() {
    // Colder than it is served, and to nothing: it stands still more often.
    let silence = wav16(1, 16_000, &vec![0; 20 * 16_000]);
    let standing = |anew: bool| {
        let shares = (0..16).map(|seed| {
            let dance = dance_to(silence.clone(), &redo(seed, 0.5, anew));
            slow_share(&speeds(&dance), FPS)
        });
        shares.sum::<f64>() / 16.0
    };
    let (as_it_comes, anew) = (standing(false), standing(true));
    println!("{as_it_comes:.4} of the frames stand still, {anew:.4} where phrases are danced anew");
    // Of 40 seeds it is two fifths; of these, chance has a say.
    assert!(anew < 0.7 * as_it_comes, "{as_it_comes} {anew}");
}

#[test]
fn suppressed_codes_are_never_drawn() {
    let suppressed = &engine().manifest().suppressed_codes;
    assert!(!suppressed.lower.is_empty());
    for seed in 0..4 {
        // Hotter than it is served: a code in forty would be one of them.
        let codes = dance(&redo(seed, 1.5, false)).codes;
        let found = codes.lower.iter().find(|code| suppressed.lower.contains(code));
        assert_eq!(found, None, "seed {seed}");
    }
}
