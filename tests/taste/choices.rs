//! Whether choices between motions are worth their cost.

use bailando::{
    engine::{GenerationOptions, GenerationRequest},
    evaluation::{Motion, speed},
    formats::GeneratedMotion,
    motion::{beat_align_score, dance_beats, slow_share},
};
use bailando_testkit::{song, wav::wav16};

use super::DEFAULT;
use crate::support::dances;

const FPS: f64 = 60.0;

/// Metres that the mean joint moves from each frame to the next.
fn speeds(dance: &GeneratedMotion) -> Vec<f64> {
    let motion = Motion::new("demo", dance.positions.view()).unwrap();
    speed(motion.poses())
}

/// Mean nearness of the demo song's beats to the dance's (Eq. 15), over a few seeds.
fn beat_score(candidates: usize) -> f64 {
    const SEEDS: u64 = 8;
    let requests = (0..SEEDS).map(|seed| {
        let options = GenerationOptions {
            seed: Some(seed),
            candidates: Some(candidates),
            music: true,
            ..GenerationOptions::default()
        };
        GenerationRequest::audio(song("demo.ogg"), options)
    });
    let scores = dances(&DEFAULT, requests).into_iter().map(|dance| {
        let beats = &dance.music.as_ref().unwrap().beats_s;
        let music: Vec<usize> =
            beats.iter().map(|second| (second * FPS).round() as usize).collect();
        beat_align_score(&music, &dance_beats(&speeds(&dance)))
    });
    scores.sum::<f64>() / SEEDS as f64
}

#[test]
fn of_several_candidates_those_on_the_beat_are_danced() {
    let (one, six) = (beat_score(1), beat_score(6));
    println!("beat score {one:.3} of one candidate, {six:.3} of six");
    assert!(six > one + 0.03, "{one} {six}");
}

#[test]
fn regenerated_phrases_stand_still_less() {
    const SEEDS: u64 = 16;
    // Colder than it is served, and to nothing: it stands still more often.
    let silence = wav16(1, 16_000, &vec![0; 20 * 16_000]);
    let standing = |redo: bool| {
        let requests = (0..SEEDS).map(|seed| {
            let options = GenerationOptions {
                seed: Some(seed),
                temperature: Some(0.5),
                redo: Some(redo),
                ..GenerationOptions::default()
            };
            GenerationRequest::audio(silence.clone(), options)
        });
        let dances = dances(&DEFAULT, requests);
        let shares = dances.iter().map(|dance| slow_share(&speeds(dance), FPS));
        shares.sum::<f64>() / SEEDS as f64
    };
    let (as_it_comes, regenerated) = (standing(false), standing(true));
    println!(
        "{as_it_comes:.4} of the frames stand still, {regenerated:.4} where phrases are regenerated"
    );
    // Of 40 seeds it is two fifths; of these, chance has a say.
    assert!(regenerated < 0.7 * as_it_comes, "{as_it_comes} {regenerated}");
}
