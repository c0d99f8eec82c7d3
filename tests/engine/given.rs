//! Dances of given codes.

use std::sync::{Arc, Mutex};

use bailando::{
    audio::AudioRange,
    engine::{
        EngineError, GenerationOptions, GenerationRequest, MotionOutput, MotionStream, Opening,
    },
    formats::{Codes, GeneratedMotion},
    motion::FRAME_RATES,
};
use bailando_testkit::song;
use ndarray::{Array2, Axis};

use crate::support::{TINY, dance_to, music};

fn options(codes: &Codes) -> GenerationOptions {
    GenerationOptions { seed: Some(5), codes: Some(codes.clone()), ..GenerationOptions::default() }
}

fn to_demo(seconds: f64) -> GenerationOptions {
    let range = AudioRange { offset_s: 0.0, duration_s: Some(seconds) };
    GenerationOptions { seed: Some(5), range, music: true, ..GenerationOptions::default() }
}

fn danced(options: GenerationOptions) -> GeneratedMotion {
    let output = TINY.generate(GenerationRequest::codes(options)).unwrap();
    output.into_motion(TINY.manifest())
}

fn refused(request: GenerationRequest) -> String {
    let error = TINY.generate(request).unwrap_err();
    assert!(matches!(error, EngineError::Option { .. }), "{error}");
    error.to_string()
}

fn some_codes(count: u32) -> Codes {
    let vocabulary = TINY.manifest().vocabulary;
    let half = |codes: usize| (0..count).map(|code| code * 5 % codes as u32).collect();
    Codes { upper: half(vocabulary.upper), lower: half(vocabulary.lower) }
}

#[test]
fn the_codes_of_a_dance_are_that_dance() {
    let first = dance_to(&TINY, song("demo.ogg"), &to_demo(8.0));
    let again = danced(GenerationOptions { codes: Some(first.codes.clone()), ..to_demo(8.0) });
    assert_eq!(again.codes, first.codes);
    assert_eq!(again.positions, first.positions);
    assert_eq!(again.animation, first.animation);
    assert_eq!(again.continuation, first.continuation);
    assert!(again.music.is_none() && again.style.is_none());
    // Another block in its middle is another dance from there on, and the same one before.
    let mut changed = first.codes.clone();
    changed.lower[30..34]
        .fill((first.codes.lower[30] + 1) % TINY.manifest().vocabulary.lower as u32);
    let changed = danced(GenerationOptions { clean: false, ..options(&changed) });
    let plain = danced(GenerationOptions { clean: false, ..options(&first.codes) });
    // The floor is that of the whole dance: from the root on.
    let apart = |frame: usize| {
        let pose = |motion: &GeneratedMotion| {
            let pose = motion.positions.index_axis(Axis(0), frame).to_owned();
            &pose - &pose.index_axis(Axis(0), 0)
        };
        let apart = (pose(&changed) - pose(&plain)).mapv(f32::abs);
        apart.into_iter().fold(0.0, f32::max)
    };
    assert!(apart(0) < 1e-5, "{}", apart(0));
    assert!(apart(32 * 8) > 1e-3, "{}", apart(32 * 8));
}

#[test]
fn codes_decide_the_length_unless_it_is_cut() {
    let codes = some_codes(45);
    for fps in FRAME_RATES {
        let whole = danced(GenerationOptions { fps, ..options(&codes) });
        assert_eq!(whole.positions.dim().0, 6 * fps as usize, "{fps}");
        let cut = |seconds| {
            let range = AudioRange { offset_s: 0.0, duration_s: Some(seconds) };
            danced(GenerationOptions { fps, range, ..options(&codes) })
        };
        let short = cut(2.5);
        assert_eq!(short.positions.dim().0, (2.5 * f64::from(fps)) as usize, "{fps}");
        assert_eq!(short.codes.upper, codes.upper[..19], "{fps}");
        assert_eq!(cut(60.0).positions, whole.positions);
    }
    assert_eq!(danced(options(&some_codes(1))).positions.dim().0, 8);
}

#[test]
fn a_song_beside_codes_is_listened_to() {
    let options = GenerationOptions { codes: Some(some_codes(30)), ..to_demo(2.0) };
    let dance = dance_to(&TINY, song("demo.ogg"), &options);
    assert_eq!(dance.positions.dim().0, 120);
    assert!(dance.music.unwrap().tempo_bpm > 0.0);
    let range = AudioRange { offset_s: 28.0, duration_s: None };
    let dance = dance_to(&TINY, song("demo.ogg"), &GenerationOptions { range, ..options.clone() });
    assert_eq!(dance.positions.dim().0, 240);
    let warned = dance.warnings.iter().any(|text| text.starts_with("the codes last 4.0 s, the"));
    assert!(warned, "{:?}", dance.warnings);
    assert!(TINY.generate(GenerationRequest::audio(&b"noise"[..], options)).is_err());
}

#[test]
fn codes_continue_an_earlier_dance() {
    let first = dance_to(&TINY, song("demo.ogg"), &to_demo(3.05));
    let tail = first.continuation.clone().unwrap();
    let shown = usize::from(tail.shown);
    assert!(shown > 0);
    let next = danced(GenerationOptions { continue_from: Some(tail), ..options(&some_codes(20)) });
    assert_eq!(next.positions.dim().0, 20 * 8 + 8 - shown);
    assert_eq!(next.codes, some_codes(20));
    let (end, start) = (first.animation.root.last().unwrap(), next.animation.root[0]);
    assert!(end.distance(start) < 0.05, "{end} {start}");
}

/// Keeps all that it receives.
#[derive(Default)]
struct Recorder {
    opening: Mutex<Option<Opening>>,
    frames: Mutex<usize>,
}

impl MotionStream for Recorder {
    fn opened(&self, opening: Opening) {
        *self.opening.lock().unwrap() = Some(opening);
    }

    fn frames(&self, motion: Array2<f32>) {
        *self.frames.lock().unwrap() += motion.nrows();
    }
}

#[test]
fn codes_are_streamed() {
    let recorder = Arc::new(Recorder::default());
    let request = GenerationRequest::codes(options(&some_codes(200)));
    let request = request.streamed_to(Arc::clone(&recorder) as _);
    let output = TINY.generate(request).unwrap();
    assert!(matches!(output.motion, MotionOutput::Streamed));
    assert_eq!(output.codes, some_codes(200));
    assert_eq!(recorder.opening.lock().unwrap().as_ref().unwrap().frames, 1600);
    assert_eq!(*recorder.frames.lock().unwrap(), 1600);
}

#[test]
fn what_cannot_be_danced_is_refused_with_its_reason() {
    let most = TINY.manifest().vocabulary.lower - 1;
    let codes = |upper: &[u32], lower: &[u32]| Codes { upper: upper.into(), lower: lower.into() };
    let of = |codes: &Codes| refused(GenerationRequest::codes(options(codes)));
    assert_eq!(
        of(&codes(&[0, 1], &[0, 99_999])),
        format!(
            "option `codes`: number 2 of the lower codes is 99999, and this model has 0 to {most}"
        )
    );
    let pairs = "option `codes`: there are 2 upper and 1 lower codes, expected pairs";
    assert!(of(&codes(&[0, 1], &[0])).starts_with(pairs));
    assert!(of(&codes(&[], &[])).contains("at least one"));
    assert!(of(&some_codes(4501)).contains("they last 600.1 s, and at most 600 s"));
    let cut = AudioRange { offset_s: 0.0, duration_s: Some(2.0) };
    danced(GenerationOptions { range: cut, ..options(&some_codes(4501)) });

    let drawn = GenerationOptions { temperature: Some(1.0), ..options(&some_codes(4)) };
    let problem = "option `temperature`: it says how codes are chosen, and `codes` gives them";
    assert!(refused(GenerationRequest::codes(drawn)).starts_with(problem));
    let later = AudioRange { offset_s: 1.0, duration_s: None };
    let later = GenerationOptions { range: later, ..options(&some_codes(4)) };
    assert!(refused(GenerationRequest::codes(later)).starts_with("option `offset_s`"));
    let rows = music(9, TINY.manifest().features.columns);
    let request = GenerationRequest::features(rows, options(&some_codes(4)));
    assert!(refused(request).contains("give either"));
    let nothing = GenerationRequest::codes(GenerationOptions::default());
    assert_eq!(refused(nothing), "option `codes`: give them, or a song to choose them by");
}
