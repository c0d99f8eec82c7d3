//! The demo song danced to: a plausible body that moves, on the floor.

use std::collections::HashSet;

use bailando::{
    engine::{GenerationOptions, GenerationRequest},
    formats::GeneratedMotion,
    motion::{Positions, forward, lower_foot_heights},
};
use ndarray::Axis;

use super::DEFAULT;
use crate::{
    dance::{FPS, containers, distance, streamed_beside_whole},
    support::dances,
};

fn joint(positions: &Positions, frame: usize, joint: usize) -> [f32; 3] {
    [0, 1, 2].map(|axis| positions[[frame, joint, axis]])
}

/// Metres per second, mean over joints and frames.
fn mean_speed(positions: &Positions) -> f32 {
    let (frames, joints, _) = positions.dim();
    let mut sum = 0.0;
    for frame in 1..frames {
        for index in 0..joints {
            sum += distance(joint(positions, frame, index), joint(positions, frame - 1, index));
        }
    }
    sum * FPS as f32 / ((frames - 1) * joints) as f32
}

fn percentile(values: &[f32], share: f32) -> f32 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted[(share * (sorted.len() - 1) as f32).round() as usize]
}

/// DESIGN, "Standing on the floor".
fn assert_on_the_floor(dance: &GeneratedMotion, positions: &Positions, what: &str) {
    let feet = lower_foot_heights(positions, &dance.skeleton);
    for (start, window) in feet.windows(5 * FPS).enumerate() {
        let low = percentile(window, 0.05);
        assert!((low - 0.015).abs() <= 0.05, "{what}: feet at {low} m from frame {start}");
    }
}

/// A human body in every frame, that moves, on the floor.
fn assert_plausible_body(dance: &GeneratedMotion, positions: &Positions, what: &str) {
    for frame in 0..positions.dim().0 {
        let pelvis = joint(positions, frame, 0)[1];
        assert!((0.6..=1.2).contains(&pelvis), "{what}: pelvis at {pelvis} m in frame {frame}");
        let heights = positions.index_axis(Axis(0), frame);
        let highest = heights.column(1).iter().copied().fold(f32::MIN, f32::max);
        let lowest = heights.column(1).iter().copied().fold(f32::MAX, f32::min);
        let body = highest - lowest;
        assert!((0.9..=2.2).contains(&body), "{what}: {body} m tall in frame {frame}");
    }
    let speed = mean_speed(positions);
    assert!((0.3..=2.0).contains(&speed), "{what}: mean joint speed {speed} m/s");
    assert_on_the_floor(dance, positions, what);
}

/// The skeleton steps where the decoder does: it floats no more than the decoder's own feet do, and
/// both have one root.
fn assert_skeleton_follows(dance: &GeneratedMotion, skeleton: &Positions, what: &str) {
    let decoder = lower_foot_heights(&dance.positions, &dance.skeleton);
    let posed = lower_foot_heights(skeleton, &dance.skeleton);
    let (mut floating, mut apart) = (0, 0);
    for (frame, (own, posed)) in decoder.iter().zip(&posed).enumerate() {
        floating += usize::from(posed - own.max(0.0) > 0.08);
        let feet = [10, 11].map(|foot| {
            distance(joint(skeleton, frame, foot), joint(&dance.positions, frame, foot))
        });
        apart += usize::from(feet.iter().any(|&metres| metres > 0.03));
        let roots = joint(skeleton, frame, 0)[1] - joint(&dance.positions, frame, 0)[1];
        assert!(roots.abs() < 0.03, "{what}: roots {roots} m apart in frame {frame}");
    }
    assert_eq!(floating, 0, "{what}: frames that float by 8 cm");
    assert!(
        apart * 100 <= decoder.len(),
        "{what}: in {apart} frames a foot is 3 cm from the decoder's"
    );
}

fn assert_plausible(dance: &GeneratedMotion, what: &str) {
    assert_plausible_body(dance, &dance.positions, what);
    let skeleton = forward(&dance.skeleton, &dance.animation).unwrap();
    assert_plausible_body(dance, &skeleton, &format!("{what}, skeleton"));
    assert_skeleton_follows(dance, &skeleton, what);
    for (half, codes) in [("upper", &dance.codes.upper), ("lower", &dance.codes.lower)] {
        let distinct = codes.iter().collect::<HashSet<_>>().len();
        assert!(distinct >= 30, "{what}: {distinct} distinct {half} codes");
    }
}

#[test]
fn every_container_of_the_demo_song_becomes_a_plausible_dance() {
    let songs = containers();
    let requests = songs.iter().map(|(_, audio)| {
        // Of this seed's dances none dips as deep as some do (model card).
        let options =
            GenerationOptions { seed: Some(7), music: true, ..GenerationOptions::default() };
        GenerationRequest::audio(audio.clone(), options)
    });
    for (dance, (name, _)) in dances(&DEFAULT, requests).iter().zip(&songs) {
        assert_plausible(dance, name);
    }
}

#[test]
fn a_pair_of_codes_is_a_pose_that_stands() {
    let pose = DEFAULT.pose([3, 7]).wait().unwrap();
    let skeleton = &DEFAULT.manifest().skeleton;
    assert!(lower_foot_heights(&pose, skeleton).iter().all(|h| h.abs() < 0.1));
}

#[test]
fn a_stream_stands_on_the_floor_of_the_whole_dance() {
    for (fps, seed) in [60, 30].into_iter().flat_map(|fps| (3..=5).map(move |seed| (fps, seed))) {
        let apart = streamed_beside_whole(&DEFAULT, fps, seed);
        println!("{fps} fps, seed {seed}: heights of the stream differ by {apart:.4} m at most");
        assert!(apart < 0.03, "{apart}");
    }
}
