//! Single runs of the three graphs against the golden vectors (ARCHITECTURE section 5). Sampling
//! itself is the engine's: here every window is given.

use std::{ops::Range, path::Path};

use crate::common::{
    self, TOLERANCE, assert_close, codes, fixture, floats, imported, options, rows, shared,
};
use bailando::{
    engine::{Engine, EngineConfig, GenerationOptions, GenerationRequest},
    model::{Gpt, Logits, ModelDirectory, NextStep, Steps, WeightStorage, WindowKind, code_pairs},
};
use bailando_train::{HostTensor, export::write_model_directory, onnx::InputRanges};
use ndarray::{Array1, Array2, Axis};

/// Longest history while sampling.
const CONTEXT: usize = 28;

/// One of the two golden samplings.
struct Sampling {
    name: &'static str,
    /// Codes kept when the window moves.
    kept: usize,
}

const SAMPLINGS: [Sampling; 2] =
    [Sampling { name: "slide", kept: 28 }, Sampling { name: "shift15", kept: 15 }];

impl Sampling {
    fn codes(&self) -> (Vec<u32>, Vec<u32>) {
        let half = |half: &str| codes(&fixture(&format!("codes_{}_{half}.npy", self.name)));
        (half("up"), half("down"))
    }

    /// Length of the window at step `k` (ARCHITECTURE section 3).
    fn window(&self, k: usize) -> usize {
        if k < CONTEXT {
            return k + 1;
        }
        let period = (CONTEXT - self.kept + 1) as i64;
        self.kept + (k as i64 - CONTEXT as i64 - 1).rem_euclid(period) as usize
    }
}

/// Runs codes `from..to` of the golden models.
fn run(gpt: &mut Gpt, codes: &(Vec<u32>, Vec<u32>), from: usize, to: usize) -> Logits {
    let music = floats(&fixture("music.npy"));
    let steps = Steps {
        codes: &pairs(codes, from..to),
        // The reference drops the first row of music.
        music: rows(&music, from + 1..to + 1),
    };
    gpt.logits(steps).unwrap()
}

fn pairs((upper, lower): &(Vec<u32>, Vec<u32>), range: Range<usize>) -> Vec<[u32; 2]> {
    code_pairs(&upper[range.clone()], &lower[range]).unwrap()
}

fn last_row(logits: &Array2<f32>) -> Array2<f32> {
    let row = logits.index_axis(Axis(0), logits.nrows() - 1);
    row.insert_axis(Axis(0)).to_owned()
}

fn golden_row(name: &str) -> Array2<f32> {
    let row: Array1<f32> = ndarray_npy::read_npy(fixture(name)).unwrap();
    row.insert_axis(Axis(0))
}

fn check_logits(directory: &ModelDirectory) {
    let mut gpt = directory.gpt(1).unwrap();
    for sampling in SAMPLINGS {
        let codes = sampling.codes();
        for k in [0, 10, 28, 40] {
            let from = k + 1 - sampling.window(k);
            let logits = run(&mut gpt, &codes, from, k + 1);
            for (half, found) in [("up", &logits.upper), ("down", &logits.lower)] {
                let name = format!("logits_{}_k{k}_{half}.npy", sampling.name);
                assert_close(&last_row(found), &golden_row(&name), TOLERANCE, &name);
            }
        }
    }
}

fn check_block(directory: &ModelDirectory) {
    let mut gpt = directory.gpt(1).unwrap();
    let logits = run(&mut gpt, &SAMPLINGS[0].codes(), 0, 29);
    for (half, found) in [("up", &logits.upper), ("down", &logits.lower)] {
        let name = format!("block_logits_{half}.npy");
        assert_close(found, &floats(&fixture(&name)), TOLERANCE, &name);
    }
}

fn check_vqvae(directory: &ModelDirectory) {
    let mut decoder = directory.decoder(1).unwrap();
    for (sampling, name) in SAMPLINGS.iter().zip(["decode_raw", "decode_raw_shift15"]) {
        let codes = sampling.codes();
        let motion = decoder.decode(&pairs(&codes, 0..codes.0.len())).unwrap();
        let golden = floats(&fixture(&format!("{name}.npy")));
        assert_close(&motion, &golden, TOLERANCE, name);
    }
    let motion = floats(&fixture("motion.npy"));
    let encoded = directory.encoder(1).unwrap().encode(motion.view());
    let encoded = encoded.unwrap().into_iter();
    let (upper, lower): (Vec<u32>, Vec<u32>) = encoded.map(|[up, down]| (up, down)).unzip();
    assert_eq!(upper, codes(&fixture("enc_up.npy")));
    assert_eq!(lower, codes(&fixture("enc_down.npy")));
}

fn check_all(directory: &ModelDirectory) {
    check_logits(directory);
    check_block(directory);
    check_vqvae(directory);
}

#[test]
fn the_zip_checkpoints_give_the_golden_values() {
    let (_folder, directory) = imported(|_| {});
    check_all(&directory);
}

fn check_variant(test: &str, vqvae: &str, gpt: &str) {
    let Some(golden) = shared(test, "model/golden") else {
        return;
    };
    let (_folder, directory) = imported(|options| {
        options.vqvae = golden.join(vqvae);
        options.gpt = golden.join(gpt);
    });
    check_all(&directory);
}

#[test]
fn the_legacy_checkpoints_give_the_golden_values() {
    check_variant(
        "the_legacy_checkpoints_give_the_golden_values",
        "tiny_vqvae_legacy.pt",
        "tiny_gpt_legacy.pt",
    );
}

#[test]
fn the_torch_1_6_checkpoints_give_the_golden_values() {
    check_variant(
        "the_torch_1_6_checkpoints_give_the_golden_values",
        "tiny_vqvae_torch16.pt",
        "tiny_gpt_torch16.pt",
    );
}

#[test]
fn a_checkpoint_without_critic_gives_the_golden_values() {
    check_variant(
        "a_checkpoint_without_critic_gives_the_golden_values",
        "tiny_vqvae.pt",
        "tiny_gpt_nocritic.pt",
    );
}

#[test]
fn cached_single_steps_equal_the_whole_window() {
    let (_folder, directory) = imported(|_| {});
    let mut gpt = directory.gpt(1).unwrap();
    let codes = SAMPLINGS[1].codes();
    let music = floats(&fixture("music.npy"));
    for prefilled in [0, 1, 15] {
        let mut cache = gpt.cache(1);
        if prefilled > 0 {
            let steps = Steps {
                codes: &pairs(&codes, 0..prefilled),
                music: rows(&music, 1..prefilled + 1),
            };
            gpt.prefill(&mut cache, 0, steps).unwrap();
        }
        for step in prefilled..CONTEXT {
            assert_eq!(cache.steps(0), step);
            let next =
                NextStep { codes: [codes.0[step], codes.1[step]], music: music.row(step + 1) };
            let single = gpt.step(&mut cache, &[next]).unwrap();
            let whole = run(&mut gpt, &codes, 0, step + 1);
            let what = format!("step {step} after a prefill of {prefilled}");
            assert_close(&single.upper, &last_row(&whole.upper), TOLERANCE, &what);
            assert_close(&single.lower, &last_row(&whole.lower), TOLERANCE, &what);
        }
    }
}

#[test]
fn the_future_is_hidden() {
    let (_folder, directory) = imported(|_| {});
    let mut gpt = directory.gpt(1).unwrap();
    let codes = SAMPLINGS[0].codes();
    let mut other = codes.clone();
    other.0[20] = (other.0[20] + 1) % 16;
    other.1[20] = (other.1[20] + 1) % 16;
    let [first, second] = [&codes, &other].map(|codes| run(&mut gpt, codes, 0, 28));
    let changed: Vec<usize> =
        (0..28).filter(|&row| first.upper.row(row) != second.upper.row(row)).collect();
    assert_eq!(changed, (20..28).collect::<Vec<_>>());
}

/// Decodes in chunks of `length` codes with `overlap` codes on either side, and joins the middles.
fn decode_chunked(
    directory: &ModelDirectory,
    codes: &(Vec<u32>, Vec<u32>),
    length: usize,
    overlap: usize,
) -> Array2<f32> {
    let mut decoder = directory.decoder(1).unwrap();
    let total = codes.0.len();
    let mut parts = Vec::new();
    for start in (0..total).step_by(length) {
        let end = (start + length).min(total);
        let from = start.saturating_sub(overlap);
        let to = (end + overlap).min(total);
        let chunk = decoder.decode(&pairs(codes, from..to));
        let middle = 8 * (start - from)..8 * (end - from);
        parts.push(rows(&chunk.unwrap(), middle).to_owned());
    }
    let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
    ndarray::concatenate(Axis(0), &views).unwrap()
}

#[test]
fn chunks_that_overlap_by_the_receptive_field_decode_as_the_whole() {
    let (_folder, directory) = imported(|_| {});
    let overlap = directory.manifest().decoder.receptive_codes;
    // Three blocks of dilations 1, 3, 9 at three rates, and the two outer convolutions.
    assert_eq!(overlap, 25);
    let (upper, lower) = SAMPLINGS[0].codes();
    let codes = (upper.repeat(3), lower.repeat(3));
    let whole = decode_chunked(&directory, &codes, codes.0.len(), 0);
    for length in [7, 40, 64] {
        let chunked = decode_chunked(&directory, &codes, length, overlap);
        assert_close(&chunked, &whole, TOLERANCE, &format!("chunks of {length}"));
    }
    let careless = decode_chunked(&directory, &codes, 40, 1);
    let difference = (&careless - &whole).mapv(f32::abs);
    assert!(difference.iter().any(|&d| d > 1e-3), "an overlap of 1 would do");
}

#[test]
fn a_code_moves_frames_within_the_receptive_field_only() {
    let (_folder, directory) = imported(|_| {});
    let reach = directory.manifest().decoder.receptive_codes;
    let mut decoder = directory.decoder(1).unwrap();
    let changed_code = 40;
    let codes = vec![[3; 2]; 80];
    let mut moved = codes.clone();
    moved[changed_code] = [9; 2];
    let [before, after] = [&codes, &moved].map(|codes| decoder.decode(codes).unwrap());
    let moved: Vec<usize> = (0..80)
        .filter(|code| {
            let frames = 8 * code..8 * code + 8;
            rows(&before, frames.clone()) != rows(&after, frames)
        })
        .collect();
    let (first, last) = (moved[0], moved[moved.len() - 1]);
    // Exactly: a smaller overlap would not do, a larger one would be wasted.
    assert_eq!((first, last), (changed_code - reach, changed_code + reach));
}

#[test]
fn half_precision_weights_stay_close() {
    let (_folder, exact) = imported(|_| {});
    let (_other, halved) = imported(|options| options.description.weights = WeightStorage::F16);
    let size = |directory: &ModelDirectory| directory.manifest().files["decoder.onnx"].bytes;
    assert!(size(&halved) * 10 < size(&exact) * 7);
    let codes = SAMPLINGS[0].codes();
    let whole = |directory| decode_chunked(directory, &codes, 60, 0);
    let difference = (whole(&exact) - whole(&halved)).mapv(f32::abs);
    let worst = difference.iter().copied().fold(0.0_f32, f32::max);
    assert!(worst > 0.0 && worst < 1e-2, "{worst}");
}

#[test]
fn the_model_predicts_the_golden_codes() {
    let (_folder, directory) = imported(|_| {});
    let mut gpt = directory.gpt(1).unwrap();
    for sampling in SAMPLINGS {
        let codes = sampling.codes();
        for k in 0..codes.0.len() - 1 {
            let from = k + 1 - sampling.window(k);
            let logits = run(&mut gpt, &codes, from, k + 1);
            let next = [&logits.upper, &logits.lower].map(|half| first_maximum(&last_row(half)));
            let expected = [codes.0[k + 1], codes.1[k + 1]];
            let name = sampling.name;
            assert_eq!(next.map(|code| code as u32), expected, "{name} step {k}");
        }
    }
}

/// The engine's own loop over the golden music, by the same independent implementation.
#[test]
fn the_engine_repeats_the_golden_codes() {
    let (folder, _directory) = imported(|_| {});
    let engine = Engine::open(&EngineConfig {
        threads: 1,
        ..EngineConfig::new(folder.path().join("model"))
    })
    .unwrap();
    let start = codes(&fixture("start_codes.npy"));
    for (sampling, window) in SAMPLINGS.iter().zip([WindowKind::Sliding, WindowKind::Hop]) {
        let options = GenerationOptions {
            start_upper: Some(start[0]),
            start_lower: Some(start[1]),
            temperature: Some(0.0),
            window: Some(window),
            hop: Some(sampling.kept),
            ..GenerationOptions::default()
        };
        let music = floats(&fixture("music.npy"));
        let request = GenerationRequest::features(music, options);
        let dance = engine.generate(request).unwrap();
        let found = (dance.codes.upper, dance.codes.lower);
        assert_eq!(found, sampling.codes(), "{}", sampling.name);
    }
}

#[test]
fn a_model_of_two_trainings_is_refused() {
    let (vqvae, mut gpt) = (common::vqvae(), common::gpt());
    for table in [&mut gpt.upper_embedding, &mut gpt.upper_head] {
        let twice = [table.data(), table.data()].concat();
        *table = HostTensor::new(vec![32, table.dim(1)], twice).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("model");
    let description = options(Path::new(""), Path::new(""), &out).description;
    let ranges = InputRanges::default();
    let refused = write_model_directory(&out, false, &gpt, &ranges, &vqvae, &description);
    assert_eq!(
        refused.unwrap_err().to_string(),
        "the GPT has 32 upper codes, but the VQ-VAE's codebook has 16: are they of the same model?"
    );
    assert!(!out.exists());
}

fn first_maximum(row: &Array2<f32>) -> usize {
    let best = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    row.iter().position(|&value| value == best).unwrap()
}
