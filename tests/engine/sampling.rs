//! Whole samplings by the engine on the golden model: codes, motion and joints (ARCHITECTURE
//! section 5), cancellation, and a queue that says when it is full.

use std::sync::{
    Arc, Barrier,
    atomic::{AtomicUsize, Ordering},
};

use bailando::{
    engine::{Engine, EngineError, GenerationOptions, GenerationRequest, Progress},
    model::{ModelDirectory, WindowKind, code_pairs},
    motion::integrate_root,
};
use bailando_testkit::{
    arrays::{assert_close, codes, floats},
    model::tiny,
};

use super::{golden, open};
use crate::support::music;

/// Largest absolute difference that float32 results may have (ARCHITECTURE section 5).
const TOLERANCE: f32 = 2e-5;
/// Start codes of the golden samplings.
const START: (u32, u32) = (8, 3);

fn tiny_engine() -> Engine {
    open(&tiny()).unwrap()
}

fn options(window: WindowKind) -> GenerationOptions {
    GenerationOptions {
        start_upper: Some(START.0),
        start_lower: Some(START.1),
        window: Some(window),
        hop: Some(15),
        seed: Some(1),
        ..GenerationOptions::default()
    }
}

fn assert_golden_sampling(engine: &Engine, window: WindowKind, name: &str) {
    let music = floats(&golden("music.npy"));
    let request = GenerationRequest::features(music, options(window));
    let dance = engine.generate(request).unwrap();
    assert_eq!(dance.codes.upper, codes(&golden(&format!("codes_{name}_up.npy"))), "{name}");
    assert_eq!(dance.codes.lower, codes(&golden(&format!("codes_{name}_down.npy"))), "{name}");
    let raw = if name == "slide" { "decode_raw.npy" } else { "decode_raw_shift15.npy" };
    let motion = dance.into_decoded();
    assert_close(&motion, &floats(&golden(raw)), TOLERANCE, raw);
    if name == "slide" {
        let joints = integrate_root(motion.view(), [0.0; 3]).unwrap();
        let frames = joints.dim().0;
        let joints = joints.into_shape_with_order((frames, 72)).unwrap();
        assert_close(&joints, &floats(&golden("joints_abs.npy")), TOLERANCE, "joints_abs.npy");
    }
}

#[test]
fn both_windows_give_the_golden_codes_and_motion() {
    let engine = tiny_engine();
    assert_golden_sampling(&engine, WindowKind::Sliding, "slide");
    assert_golden_sampling(&engine, WindowKind::Hop, "shift15");
}

/// A long random piece: more than two chunks, so that inner chunk borders exist.
#[test]
fn a_piece_decodes_the_same_in_chunks_and_at_once() {
    let engine = tiny_engine();
    let mut options = options(WindowKind::Hop);
    options.temperature = Some(1.0);
    let dance = engine.generate(GenerationRequest::features(music(200, 438), options)).unwrap();
    let codes = code_pairs(&dance.codes.upper, &dance.codes.lower).unwrap();
    let directory = ModelDirectory::open(&tiny()).unwrap();
    let whole = directory.decoder(1).unwrap().decode(&codes).unwrap();
    assert_eq!(whole.nrows(), 1600);
    assert_close(&dance.into_decoded(), &whole, 1e-6, "chunked decoding");
}

#[test]
fn seeds_decide_the_dance_and_given_codes_begin_it() {
    let engine = tiny_engine();
    let dance = |seed, start: Option<u32>| {
        let mut options = options(WindowKind::Hop);
        options.seed = Some(seed);
        options.temperature = Some(1.0);
        options.start_upper = start;
        let music = floats(&golden("music.npy"));
        engine.generate(GenerationRequest::features(music, options)).unwrap().codes
    };
    assert_eq!(dance(4, None), dance(4, None));
    assert_ne!(dance(4, None), dance(5, None));
    assert_eq!(dance(4, Some(11)).upper[0], 11);
    assert_eq!(dance(4, Some(11)).lower[0], START.1);
}

/// Stops at its first code until it is told to go on, and counts the codes after it.
struct Gate {
    reached: Barrier,
    open: Barrier,
    codes: AtomicUsize,
}

impl Gate {
    fn new() -> Arc<Self> {
        Arc::new(Self {
            reached: Barrier::new(2),
            open: Barrier::new(2),
            codes: AtomicUsize::new(0),
        })
    }
}

impl Progress for Gate {
    fn codes(&self, _done: usize, _total: usize) {
        if self.codes.fetch_add(1, Ordering::SeqCst) == 0 {
            self.reached.wait();
            self.open.wait();
        }
    }
}

fn golden_request(progress: Arc<dyn Progress>) -> GenerationRequest {
    let music = floats(&golden("music.npy"));
    GenerationRequest::features(music, options(WindowKind::Hop)).with_progress(progress)
}

#[test]
fn cancellation_stops_at_the_next_step_and_the_model_dances_on() {
    let engine = tiny_engine();
    let gate = Gate::new();
    let generation = engine.submit(golden_request(gate.clone()));
    gate.reached.wait();
    drop(generation);
    gate.open.wait();
    assert_golden_sampling(&engine, WindowKind::Hop, "shift15");
    let codes = gate.codes.load(Ordering::SeqCst);
    assert_eq!(codes, 1, "no code after the cancellation");
}

#[test]
fn a_full_queue_is_an_error_not_a_wait() {
    let engine = tiny_engine();
    let gate = Gate::new();
    let running = engine.submit(golden_request(gate.clone()));
    gate.reached.wait();
    // One is running; of two more, one fits the queue of one and the other must be refused.
    let waiting = engine.submit(golden_request(Arc::new(())));
    let refused = engine.generate(golden_request(Arc::new(()))).unwrap_err();
    assert!(matches!(refused, EngineError::QueueFull { capacity: 1 }));
    gate.open.wait();
    assert!(running.wait().is_ok());
    assert!(waiting.wait().is_ok());
}

#[test]
fn a_request_cancelled_in_the_queue_frees_its_place() {
    let engine = tiny_engine();
    let gate = Gate::new();
    let running = engine.submit(golden_request(gate.clone()));
    gate.reached.wait();
    // The model is held: these wait, one after another, in the one place.
    for _ in 0..3 {
        drop(engine.submit(golden_request(Arc::new(()))));
    }
    let last = engine.submit(golden_request(Arc::new(())));
    gate.open.wait();
    assert!(running.wait().is_ok());
    assert!(last.wait().is_ok());
    assert!(engine.is_alive());
}
