//! Whole samplings by the engine on imported golden models: codes, motion and joints (ARCHITECTURE
//! section 5), cancellation, and a queue that says when it is full.

use std::{
    path::Path,
    sync::{
        Arc, Barrier,
        atomic::{AtomicUsize, Ordering},
    },
};

use crate::common::{TOLERANCE, assert_close, codes, fixture, floats, imported, shared};
use bailando::{
    engine::{Engine, EngineConfig, EngineError, GenerationOptions, GenerationRequest, Progress},
    model::{WindowKind, code_pairs},
    motion::integrate_root,
};
use ndarray::Array2;
use tempfile::TempDir;

/// Start codes of the golden samplings.
const START: (u32, u32) = (8, 3);

fn open(folder: &TempDir) -> Engine {
    Engine::open(&EngineConfig { threads: 1, ..EngineConfig::new(folder.path().join("model")) })
        .unwrap()
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
    let music = floats(&fixture("music.npy"));
    let request = GenerationRequest::features(music, options(window));
    let dance = engine.generate(request).unwrap();
    assert_eq!(dance.codes.upper, codes(&fixture(&format!("codes_{name}_up.npy"))), "{name}");
    assert_eq!(dance.codes.lower, codes(&fixture(&format!("codes_{name}_down.npy"))), "{name}");
    let raw = if name == "slide" { "decode_raw.npy" } else { "decode_raw_shift15.npy" };
    let motion = dance.into_decoded();
    assert_close(&motion, &floats(&fixture(raw)), TOLERANCE, raw);
    if name == "slide" {
        let joints = integrate_root(motion.view(), [0.0; 3]).unwrap();
        let frames = joints.dim().0;
        let joints = joints.into_shape_with_order((frames, 72)).unwrap();
        assert_close(&joints, &floats(&fixture("joints_abs.npy")), TOLERANCE, "joints_abs.npy");
    }
}

fn assert_golden(folder: &TempDir) {
    let engine = open(folder);
    assert_golden_sampling(&engine, WindowKind::Sliding, "slide");
    assert_golden_sampling(&engine, WindowKind::Hop, "shift15");
}

#[test]
fn both_windows_give_the_golden_codes_and_motion() {
    let (folder, _) = imported(|_| {});
    assert_golden(&folder);
}

#[test]
fn every_checkpoint_variant_gives_the_golden_codes_and_motion() {
    let variants = [
        ("tiny_gpt_legacy.pt", "tiny_vqvae_legacy.pt"),
        ("tiny_gpt_torch16.pt", "tiny_vqvae_torch16.pt"),
        ("tiny_gpt_nocritic.pt", "tiny_vqvae.pt"),
    ];
    for (gpt, vqvae) in variants {
        let find = |name: &str| shared("golden sampling", &format!("model/golden/{name}"));
        let (Some(gpt), Some(vqvae)) = (find(gpt), find(vqvae)) else {
            return;
        };
        let (folder, _) = imported(|options| {
            options.gpt = gpt.clone();
            options.vqvae = vqvae.clone();
        });
        assert_golden(&folder);
    }
}

/// A long random piece: more than two chunks, so that inner chunk borders exist.
#[test]
fn a_piece_decodes_the_same_in_chunks_and_at_once() {
    let (folder, directory) = imported(|_| {});
    let engine = open(&folder);
    let music = Array2::from_shape_fn((200, 438), |(row, column)| {
        ((row * 31 + column * 7) % 97) as f32 / 97.0 - 0.5
    });
    let mut options = options(WindowKind::Hop);
    options.temperature = Some(1.0);
    let dance = engine.generate(GenerationRequest::features(music, options)).unwrap();
    let codes = code_pairs(&dance.codes.upper, &dance.codes.lower).unwrap();
    let whole = directory.decoder(1).unwrap().decode(&codes).unwrap();
    assert_eq!(whole.nrows(), 1600);
    assert_close(&dance.into_decoded(), &whole, 1e-6, "chunked decoding");
}

#[test]
fn seeds_decide_the_dance_and_given_codes_begin_it() {
    let (folder, _) = imported(|_| {});
    let engine = open(&folder);
    let dance = |seed, start: Option<u32>| {
        let mut options = options(WindowKind::Hop);
        options.seed = Some(seed);
        options.temperature = Some(1.0);
        options.start_upper = start;
        let music = floats(&fixture("music.npy"));
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
    let music = floats(&fixture("music.npy"));
    GenerationRequest::features(music, options(WindowKind::Hop)).with_progress(progress)
}

#[test]
fn cancellation_stops_at_the_next_step_and_the_model_dances_on() {
    let (folder, _) = imported(|_| {});
    let engine = open(&folder);
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
    let (folder, _) = imported(|_| {});
    let engine = open(&folder);
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
    let (folder, _) = imported(|_| {});
    let engine = open(&folder);
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

/// A manifest that lies about its graphs, with hashes that fit, is found out at start.
#[test]
fn a_manifest_that_does_not_fit_its_graphs_is_refused_at_start() {
    let (folder, _) = imported(|_| {});
    let path = folder.path().join("model/manifest.json");
    let honest: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let lies = [
        ("/vocabulary/upper", 32_u64),
        ("/vocabulary/lower", 8),
        ("/gpt/heads", 3),
        ("/gpt/layers", 3),
        ("/gpt/layers", 1_000_000_000),
        ("/gpt/block", u64::MAX),
        ("/gpt/context", 29),
        ("/gpt/channels", 96),
        ("/decoder/receptive_codes", 0),
        ("/decoder/receptive_codes", u64::MAX),
        ("/decoder/width", 0),
    ];
    for (place, value) in lies {
        let mut manifest = honest.clone();
        *manifest.pointer_mut(place).unwrap() = value.into();
        std::fs::write(&path, manifest.to_string()).unwrap();
        let result = Engine::open(&EngineConfig {
            threads: 1,
            ..EngineConfig::new(folder.path().join("model"))
        });
        let error = result.expect_err(place).to_string();
        assert!(!error.contains('\n'), "{place} {value}: {error}");
        println!("{place} = {value}: {error}");
    }
}

#[test]
fn a_directory_that_does_not_fit_its_manifest_is_refused_in_one_line() {
    let (folder, _) = imported(|_| {});
    let model = folder.path().join("model");
    let refused = |expected: &str| {
        let error = bailando::model::ModelDirectory::open(&model).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert!(!error.contains('\n'), "{error}");
    };
    let decoder = model.join("decoder.onnx");
    let bytes = std::fs::read(&decoder).unwrap();
    std::fs::write(&decoder, &bytes[..bytes.len() / 2]).unwrap();
    refused("decoder.onnx: the size in bytes is");
    let mut changed = bytes.clone();
    changed[bytes.len() / 2] ^= 1;
    std::fs::write(&decoder, &changed).unwrap();
    refused("decoder.onnx: the SHA-256 is");
    std::fs::remove_file(&decoder).unwrap();
    refused("decoder.onnx");
    std::fs::write(&decoder, &bytes).unwrap();

    let manifest = model.join("manifest.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    let write = |path: &Path, text: &str| std::fs::write(path, text).unwrap();
    write(&manifest, &text.replace("\"decoder.onnx\"", "\"../decoder.onnx\""));
    refused("manifest.json");
    write(&manifest, "{}");
    refused("manifest.json");
}
