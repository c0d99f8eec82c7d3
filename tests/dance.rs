//! The demo song danced to, as long as the song in every container, whole, in pieces and on from
//! another dance.

use std::sync::{Arc, Mutex};

use bailando::{
    CancelToken,
    audio::{AudioLimits, AudioRange},
    engine::{Engine, GenerationOptions, GenerationRequest, MotionOutput, MotionStream, Opening},
    formats::{Continuation, GeneratedMotion, OutputFormat, WriteOptions},
    motion::{self, FinishOptions, Finisher, PositionsSource},
};
use bailando_testkit::{song, sound, wav::wav16};
use ndarray::{Array2, Array3, Axis, Slice};

use crate::support::{TINY, dance_to, dances, music};

const SONG_SECONDS: f64 = 30.0;
pub(crate) const FPS: usize = 60;

/// A dance to the first seconds of a song.
fn dance(audio: Vec<u8>, seed: u64) -> GeneratedMotion {
    let options = GenerationOptions {
        seed: Some(seed),
        range: AudioRange { offset_s: 0.0, duration_s: Some(8.0) },
        ..GenerationOptions::default()
    };
    dance_to(&TINY, audio, &options)
}

/// The flac's samples as a 16-bit mono wav at its own rate.
fn wav_of_the_flac() -> Vec<u8> {
    const RATE: u32 = 32_000;
    let decoded = bailando::audio::decode(
        song("demo.flac").into(),
        Default::default(),
        &[RATE],
        &AudioLimits::default(),
        &CancelToken::new(),
    )
    .unwrap();
    wav(&decoded.signals[0], RATE)
}

/// A 16-bit mono wav.
fn wav(samples: &[f32], rate: u32) -> Vec<u8> {
    let rounded = |sample: &f32| (sample * 32_768.0).round().clamp(-32_768.0, 32_767.0) as i16;
    wav16(1, rate, &samples.iter().map(rounded).collect::<Vec<_>>())
}

/// Ten seconds of clicks at 90 beats a minute over a low note: another song.
fn other_song() -> Vec<u8> {
    const RATE: u32 = 22_050;
    let samples: Vec<f32> = (0..10 * RATE)
        .map(|index| {
            let time = index as f32 / RATE as f32;
            let since_beat = time % (60.0 / 90.0);
            let click = (-since_beat * 60.0).exp() * (time * 6_000.0).sin();
            0.5 * click + 0.2 * (time * 2.0 * std::f32::consts::PI * 110.0).sin()
        })
        .collect();
    wav(&samples, RATE)
}

pub(crate) fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
}

/// The demo song in every container.
pub(crate) fn containers() -> Vec<(&'static str, Vec<u8>)> {
    let songs = ["demo.ogg", "demo.mp3", "demo.flac", "demo.m4a"];
    let songs = songs.map(|name| (name, song(name)));
    songs.into_iter().chain([("demo.wav", wav_of_the_flac())]).collect()
}

#[test]
fn every_container_of_the_demo_song_becomes_a_dance_of_its_length() {
    let songs = containers();
    let requests = songs.iter().map(|(_, audio)| {
        let options =
            GenerationOptions { seed: Some(7), music: true, ..GenerationOptions::default() };
        GenerationRequest::audio(audio.clone(), options)
    });
    for (dance, (name, _)) in dances(&TINY, requests).iter().zip(&songs) {
        let frames = dance.positions.dim().0;
        let expected = (SONG_SECONDS * FPS as f64) as usize;
        assert!(frames.abs_diff(expected) <= 8, "{name}: {frames} frames");
        let write = |format: OutputFormat| format.write(dance, &WriteOptions::default()).unwrap();
        let json = write(OutputFormat::Json);
        let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
        assert_eq!(json["frames"], frames, "{name}");
        let bvh = String::from_utf8(write(OutputFormat::Bvh)).unwrap();
        assert!(bvh.contains(&format!("Frames: {frames}")), "{name}");
    }
}

#[test]
fn two_seeds_and_two_songs_give_different_dances_and_a_seed_repeats_itself() {
    let demo = || song("demo.ogg");
    let first = dance(demo(), 1).codes;
    assert_eq!(first, dance(demo(), 1).codes);
    assert_ne!(first, dance(demo(), 2).codes);
    let other = dance(other_song(), 1).codes;
    let length = other.upper.len().min(first.upper.len());
    assert_ne!(first.upper[..length], other.upper[..length]);
    assert_ne!(first.lower[..length], other.lower[..length]);
}

#[test]
fn guidance_of_1_is_the_model_itself_and_more_is_another_dance() {
    let guided = |guidance: Option<f32>| {
        let options = GenerationOptions {
            seed: Some(4),
            guidance,
            range: AudioRange { offset_s: 0.0, duration_s: Some(8.0) },
            ..GenerationOptions::default()
        };
        dance_to(&TINY, song("demo.ogg"), &options).codes
    };
    let default = TINY.manifest().sampling.guidance;
    let own = guided(Some(1.0));
    if default == 1.0 {
        assert_eq!(own, guided(None));
    }
    let more = guided(Some(4.0));
    assert_ne!(own, more);
    assert_eq!(more, guided(Some(4.0)));
}

/// Keeps all that it receives.
#[derive(Default)]
struct Recorder {
    opening: Mutex<Option<Opening>>,
    motion: Mutex<Vec<Array2<f32>>>,
}

impl MotionStream for Recorder {
    fn opened(&self, opening: Opening) {
        *self.opening.lock().unwrap() = Some(opening);
    }

    fn frames(&self, motion: Array2<f32>) {
        self.motion.lock().unwrap().push(motion);
    }
}

/// Checks that a stream is the whole dance in pieces; returns how far their heights are apart at
/// most, for a whole dance knows more of where the floor is than what was heard so far.
pub(crate) fn streamed_beside_whole(engine: &Engine, fps: u32, seed: u64) -> f32 {
    // What clean-up makes of feet depends on the floor, of which a stream knows less.
    let options = GenerationOptions {
        seed: Some(seed),
        fps,
        music: true,
        clean: false,
        ..GenerationOptions::default()
    };
    let whole = dance_to(engine, song("demo.ogg"), &options);
    let recorder = Arc::new(Recorder::default());
    let request = GenerationRequest::audio(song("demo.ogg"), options);
    let request = request.streamed_to(Arc::clone(&recorder) as _);
    let ending = engine.generate(request).unwrap();
    assert!(matches!(ending.motion, MotionOutput::Streamed));
    assert_eq!(ending.codes, whole.codes);
    // Chunks of other lengths differ in the last bits.
    let tail = whole.continuation.unwrap();
    let end = ending.tail.unwrap();
    assert_eq!(end.codes, tail.codes);
    let places = end.position.iter().zip(tail.position);
    assert!(places.into_iter().all(|(a, b)| (a - b).abs() < 1e-3));
    assert!((end.heading - tail.heading).abs() < 1e-3);
    let mut opening = recorder.opening.lock().unwrap().take().unwrap();
    assert_eq!(opening.frames, whole.positions.dim().0);
    assert_eq!(opening.music, whole.music);
    let chunks = recorder.motion.lock().unwrap();
    assert!(chunks.len() > 2, "{}", chunks.len());
    let mut heights = Vec::new();
    let mut next = 0;
    for chunk in chunks.iter().map(Some).chain([None]) {
        let part = match chunk {
            Some(rows) => opening.finisher.push(rows.view()),
            None => opening.finisher.end(),
        };
        for pose in part.unwrap().positions.outer_iter() {
            let wanted = whole.positions.index_axis(Axis(0), next);
            for (index, (a, b)) in pose.iter().zip(wanted).enumerate() {
                match index % 3 {
                    1 => heights.push((a - b).abs()),
                    _ => assert!((a - b).abs() < 1e-3, "frame {next}: {a} {b}"),
                }
            }
            next += 1;
        }
    }
    assert_eq!(next, opening.frames);
    heights.into_iter().fold(0.0, f32::max)
}

#[test]
fn a_stream_is_the_dance_in_pieces() {
    for (fps, seed) in [(60, 3), (30, 4)] {
        let apart = streamed_beside_whole(&TINY, fps, seed);
        assert!(apart.is_finite(), "{fps} fps, seed {seed}: {apart}");
    }
}

/// The decoder's positions are given as they are, or refused.
#[test]
fn the_decoders_own_positions_are_for_its_own_motion() {
    let decoder = GenerationOptions {
        seed: Some(3),
        clean: false,
        positions: PositionsSource::Decoder,
        range: AudioRange { offset_s: 0.0, duration_s: Some(2.0) },
        ..GenerationOptions::default()
    };
    let dance = dance_to(&TINY, song("demo.ogg"), &decoder);
    assert_eq!(dance.positions_source, PositionsSource::Decoder);
    assert_eq!(dance.positions.dim().0, 120);
    let on_skeleton = motion::forward(&dance.skeleton, &dance.animation).unwrap();
    assert_ne!(dance.positions, on_skeleton);
    for wrong in [
        GenerationOptions { fps: 30, ..decoder.clone() },
        GenerationOptions { clean: true, ..decoder },
    ] {
        let refused = TINY.check(&wrong).unwrap_err().to_string();
        assert!(refused.contains("`positions`") && refused.contains("positions=fk"), "{refused}");
    }
}

/// A dance to a few seconds of the demo song from `offset_s` on.
fn part(offset_s: f64, continue_from: Option<Continuation>, root_motion: bool) -> GeneratedMotion {
    let options = GenerationOptions {
        seed: Some(8),
        continue_from,
        root_motion,
        range: AudioRange { offset_s, duration_s: Some(8.0) },
        ..GenerationOptions::default()
    };
    dance_to(&TINY, song("demo.ogg"), &options)
}

/// The end of a dance over the wire and back.
fn tail_of(dance: &GeneratedMotion) -> Option<Continuation> {
    Some(dance.continuation.as_ref()?.to_text().parse().unwrap())
}

/// No joint goes further from a dance's last frame to the next dance's first than it does inside.
fn assert_goes_on(first: &GeneratedMotion, second: &GeneratedMotion) {
    let (last, next) = (
        first.positions.index_axis(Axis(0), first.positions.dim().0 - 1),
        second.positions.index_axis(Axis(0), 0),
    );
    let seam = last.outer_iter().zip(next.outer_iter());
    let furthest =
        seam.map(|(a, b)| distance([a[0], a[1], a[2]], [b[0], b[1], b[2]])).fold(0.0, f32::max);
    let steps = first.positions.axis_windows(Axis(0), 2).into_iter();
    let fastest = steps
        .flat_map(|two| {
            let joints = 0..two.dim().1;
            let at = |frame: usize, joint: usize| [0, 1, 2].map(|axis| two[[frame, joint, axis]]);
            joints.map(|joint| distance(at(0, joint), at(1, joint))).collect::<Vec<_>>()
        })
        .fold(0.0, f32::max);
    println!("seam {furthest:.3} m, fastest step inside {fastest:.3} m");
    assert!(furthest < fastest + 0.02, "{furthest} {fastest}");
}

/// Largest speed (metres a frame) and change of speed of a joint between frames.
fn jumps(positions: &Array3<f32>) -> (f32, f32) {
    let frames = positions.dim().0;
    let at = |frame: usize, joint: usize| [0, 1, 2].map(|axis| positions[[frame, joint, axis]]);
    let mut largest = (0.0_f32, 0.0_f32);
    for joint in 0..positions.dim().1 {
        for frame in 1..frames {
            let [before, now] = [at(frame - 1, joint), at(frame, joint)];
            largest.0 = largest.0.max(distance(before, now));
            if frame + 1 < frames {
                let expected = [0, 1, 2].map(|axis| 2.0 * now[axis] - before[axis]);
                largest.1 = largest.1.max(distance(expected, at(frame + 1, joint)));
            }
        }
    }
    largest
}

/// Clips of 2.1 s: 126 frames each, fifteen codes and six frames of another.
#[test]
fn clips_chain_to_the_frame_without_a_seam() {
    for (fps, frames) in [(60, 126), (30, 63)] {
        let mut clips: Vec<GeneratedMotion> = Vec::new();
        let mut inside = (0.0_f32, 0.0_f32);
        for clip in 0..4 {
            let options = GenerationOptions {
                seed: Some(8),
                fps,
                continue_from: clips.last().and_then(tail_of),
                range: AudioRange { offset_s: 2.1 * f64::from(clip), duration_s: Some(2.1) },
                ..GenerationOptions::default()
            };
            let clip = dance_to(&TINY, song("demo.ogg"), &options);
            assert_eq!(clip.positions.dim().0, frames, "{fps} fps");
            let (speed, change) = jumps(&clip.positions);
            inside = (inside.0.max(speed), inside.1.max(change));
            clips.push(clip);
        }
        for pair in clips.windows(2) {
            let end = pair[0].positions.slice_axis(Axis(0), Slice::from(-2..));
            let start = pair[1].positions.slice_axis(Axis(0), Slice::from(..2));
            let seam = jumps(&ndarray::concatenate(Axis(0), &[end, start]).unwrap());
            println!("{fps} fps: seam {seam:?}, inside {inside:?}");
            assert!(seam.0 <= inside.0 && seam.1 <= inside.1, "{seam:?} {inside:?}");
        }
    }
}

#[test]
fn a_dance_goes_on_where_another_ended() {
    let first = part(0.0, None, true);
    let second = part(8.0, tail_of(&first), true);
    assert_eq!(second.positions.dim(), first.positions.dim());
    assert_goes_on(&first, &second);
    let elsewhere = part(8.0, None, true);
    assert_ne!(second.codes, elsewhere.codes);
    // And what a tail tells of another model is refused.
    let foreign = Continuation::new("00000000", first.codes.clone(), [0.0; 2], 0.0);
    let options =
        GenerationOptions { continue_from: Some(foreign), ..GenerationOptions::default() };
    let refused = TINY.check(&options).unwrap_err();
    assert!(refused.to_string().contains("another model"), "{refused}");
}

#[test]
fn a_dance_goes_on_from_one_that_was_held_in_place() {
    let walked = part(0.0, None, true);
    let held = part(8.0, tail_of(&walked), false);
    let place = |dance: &GeneratedMotion| tail_of(dance).unwrap().position;
    let [x, z] = place(&walked);
    assert!(x.hypot(z) > 0.2, "the first dance goes nowhere: {x} {z}");
    assert_eq!(place(&held), [0.0; 2]);
    let next = part(16.0, tail_of(&held), true);
    assert_goes_on(&held, &next);
    assert_ne!(place(&next), [0.0; 2]);
}

/// Pieces are finished as they are decoded, to the same motion as all of it at once.
#[test]
fn a_motion_is_finished_in_pieces_as_it_is_at_once() {
    let manifest = TINY.manifest();
    let rows = music(600, manifest.features.columns);
    let options = GenerationOptions { seed: Some(5), ..GenerationOptions::default() };
    let request = GenerationRequest::features(rows, options);
    let decoded = TINY.generate(request).unwrap().into_decoded();
    let (skeleton, finish) = (&manifest.skeleton, FinishOptions::default());
    let at_once = motion::finish(decoded.view(), skeleton, &finish).unwrap();
    let mut finisher = Finisher::whole(skeleton, &finish).unwrap();
    for chunk in decoded.axis_chunks_iter(Axis(0), 8 * 256) {
        finisher.push(chunk).unwrap();
    }
    assert_eq!(finisher.end().unwrap(), at_once);
}

#[test]
fn a_pair_of_codes_is_a_pose() {
    let pose = TINY.pose([3, 7]).wait().unwrap();
    assert_eq!(pose.dim(), (32, 24, 3));
    assert!(TINY.pose([u32::MAX, 0]).wait().is_err());
}

#[test]
fn other_frame_rates_and_a_dancer_in_place() {
    for (fps, expected) in [(20, 80), (24, 96), (30, 120), (60, 240)] {
        let options = GenerationOptions {
            seed: Some(3),
            fps,
            root_motion: false,
            range: AudioRange { offset_s: 2.0, duration_s: Some(4.0) },
            ..GenerationOptions::default()
        };
        let dance = dance_to(&TINY, song("demo.ogg"), &options);
        assert_eq!(dance.positions.dim().0, expected, "{fps} fps");
        assert_eq!(dance.animation.root.len(), expected);
        assert!(dance.animation.root.iter().all(|root| root.x == 0.0 && root.z == 0.0));
    }
}

/// Music is told with its bars, noise with a warning; the dance does not depend on what is told.
#[test]
fn beats_are_told_where_there_are_any() {
    let told = |audio: Vec<u8>, music: bool| {
        let range = AudioRange { offset_s: 0.0, duration_s: Some(8.0) };
        let seed = Some(5);
        let options = GenerationOptions { seed, music, range, ..GenerationOptions::default() };
        dance_to(&TINY, audio, &options)
    };
    let dance = told(song("demo.ogg"), true);
    let music = dance.music.as_ref().unwrap();
    assert!((music.tempo_bpm - 104.0).abs() < 1.0 && music.tempo_steady, "{music:?}");
    assert_eq!(music.metre, 4);
    assert!(music.downbeats_s.iter().all(|first| music.beats_s.contains(first)));
    assert!((3..=4).contains(&music.downbeats_s.len()) && music.confidence > 0.5, "{music:?}");
    assert_eq!(told(song("demo.ogg"), false).codes, dance.codes);
    let noise: Vec<f32> = sound::noise(8 * 22_050).iter().map(|x| 0.3 * x).collect();
    let dance = told(wav(&noise, 22_050), true);
    let music = dance.music.unwrap();
    assert!(music.beats_s.is_empty() && music.downbeats_s.is_empty(), "{music:?}");
    assert!(dance.warnings.iter().any(|warning| warning.contains("beats")), "{:?}", dance.warnings);
}
