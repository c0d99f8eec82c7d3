//! The graphs serve any batch: a batch of two equals two single runs.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests: failing loudly is their job"
)]

#[expect(dead_code, reason = "the helpers of the other tests")]
mod common;

use std::{
    env::consts::{DLL_PREFIX, DLL_SUFFIX},
    path::{Path, PathBuf},
    sync::OnceLock,
};

use bailando::model::WeightStorage;
use bailando_train::onnx::{InputRanges, decoder_graph, encoder_graph, gpt_graph};

use common::{HEADS, fixture, floats, gpt, rows, vqvae};
use ndarray::Array2;
use ort::{environment::Environment, session::Session, value::Tensor};

const STEPS: usize = 6;
const LAYERS: usize = 4;
const HEAD_SIZE: usize = 12;

/// A session of our own, since `bailando::model` runs one piece at a time.
fn session(graph: &[u8]) -> Session {
    static ENVIRONMENT: OnceLock<Environment> = OnceLock::new();
    let environment = ENVIRONMENT.get_or_init(|| {
        let library = std::env::var_os("ORT_DYLIB_PATH").map_or_else(
            || {
                let project = concat!(env!("CARGO_MANIFEST_DIR"), "/../.onnxruntime/lib");
                Path::new(project).join(format!("{DLL_PREFIX}onnxruntime{DLL_SUFFIX}"))
            },
            PathBuf::from,
        );
        ort::environment::init_from(library).unwrap().build().unwrap()
    });
    let builder = Session::builder(environment).unwrap();
    builder.with_intra_threads(1).unwrap().commit_from_memory(graph).unwrap()
}

/// Upper codes, lower codes and music rows of one sequence.
struct Sequence {
    upper: Vec<i64>,
    lower: Vec<i64>,
    music: Array2<f32>,
}

fn sequences() -> [Sequence; 2] {
    let half = |name: &str| {
        let codes = common::codes(&fixture(name));
        codes.into_iter().map(i64::from).collect::<Vec<i64>>()
    };
    let (upper, lower) = (half("codes_slide_up.npy"), half("codes_slide_down.npy"));
    let music = floats(&fixture("music.npy"));
    [0, 20].map(|from| Sequence {
        upper: upper[from..from + STEPS].to_vec(),
        lower: lower[from..from + STEPS].to_vec(),
        music: rows(&music, from..from + STEPS).to_owned(),
    })
}

/// Every output of one run over all `sequences` at once, flattened, per sequence.
fn run_gpt(session: &mut Session, sequences: &[&Sequence]) -> Vec<Vec<f32>> {
    let batch = sequences.len();
    let ints = |pick: fn(&Sequence) -> &Vec<i64>| {
        let values: Vec<i64> = sequences.iter().flat_map(|one| pick(one).clone()).collect();
        Tensor::from_array(([batch, STEPS], values)).unwrap()
    };
    let music: Vec<f32> = sequences.iter().flat_map(|one| one.music.iter().copied()).collect();
    let positions: Vec<i64> = (0..batch).flat_map(|_| 0..STEPS as i64).collect();
    let tokens = 3 * STEPS;
    let mut inputs = ort::inputs! {
        "upper" => ints(|one| &one.upper),
        "lower" => ints(|one| &one.lower),
        "music" => Tensor::from_array(([batch, STEPS, 438], music)).unwrap(),
        "positions" => Tensor::from_array(([batch, STEPS], positions)).unwrap(),
        // One mask for the whole batch.
        "attention_bias" => {
            let zeros = vec![0.0_f32; tokens * tokens];
            Tensor::from_array(([1, 1, tokens, tokens], zeros)).unwrap()
        },
    };
    for layer in 0..LAYERS {
        for kind in ["key", "value"] {
            let allocator = ort::memory::Allocator::default();
            let empty = Tensor::<f32>::new(&allocator, [batch, HEADS, 0, HEAD_SIZE]).unwrap();
            inputs.push((format!("past_{kind}.{layer}").into(), empty.into()));
        }
    }
    let outputs = session.run(inputs).unwrap();
    let mut rows = vec![Vec::new(); batch];
    for (_, value) in &outputs {
        let (_, values) = value.try_extract_tensor::<f32>().unwrap();
        for (row, part) in rows.iter_mut().zip(values.chunks(values.len() / batch)) {
            row.extend_from_slice(part);
        }
    }
    rows
}

#[test]
fn a_batch_of_two_equals_two_single_runs() {
    let weights = gpt();
    let mut session =
        session(&gpt_graph(&weights, WeightStorage::F32, &InputRanges::default()).unwrap());
    let [first, second] = sequences();
    let together = run_gpt(&mut session, &[&first, &second]);
    let apart = [&first, &second].map(|one| run_gpt(&mut session, &[one]).remove(0));
    assert_eq!(together.len(), 2);
    assert_ne!(together[0], together[1]);
    for (together, apart) in together.iter().zip(&apart) {
        // Logits of both halves, then keys and values of every layer.
        assert_eq!(apart.len(), 2 * STEPS * 16 + LAYERS * 2 * 3 * STEPS * HEADS * HEAD_SIZE);
        assert_eq!(together, apart, "bitwise");
    }
}

#[test]
fn a_batch_of_two_decodes_and_encodes_as_two_single_runs() {
    let weights = vqvae();
    let mut decoder = session(&decoder_graph(&weights, WeightStorage::F32).unwrap());
    let mut encoder = session(&encoder_graph(&weights, WeightStorage::F32).unwrap());
    let mut decode = |sequences: &[&Sequence]| -> Vec<f32> {
        let half = |pick: fn(&Sequence) -> &Vec<i64>| {
            let codes: Vec<i64> = sequences.iter().flat_map(|one| pick(one).clone()).collect();
            Tensor::from_array(([sequences.len(), STEPS], codes)).unwrap()
        };
        let inputs =
            ort::inputs! {"upper" => half(|one| &one.upper), "lower" => half(|one| &one.lower)};
        let outputs = decoder.run(inputs).unwrap();
        let (shape, motion) = outputs["motion"].try_extract_tensor::<f32>().unwrap();
        assert_eq!(**shape, [sequences.len() as i64, 8 * STEPS as i64, 72]);
        motion.to_vec()
    };
    let [first, second] = sequences();
    let together = decode(&[&first, &second]);
    let apart = [decode(&[&first]), decode(&[&second])].concat();
    assert_eq!(together, apart);

    let mut encode = |motion: &[f32], batch: usize| -> Vec<i64> {
        let shape = [batch, 8 * STEPS, 72];
        let motion = Tensor::from_array((shape, motion.to_vec())).unwrap();
        let outputs = encoder.run(ort::inputs! {"motion" => motion}).unwrap();
        let codes = ["upper", "lower"].map(|half| {
            let (_, codes) = outputs[half].try_extract_tensor::<i64>().unwrap();
            codes.chunks(STEPS).map(<[i64]>::to_vec).collect::<Vec<_>>()
        });
        // Sequence by sequence, so that batches can be compared with single runs.
        (0..batch).flat_map(|i| [codes[0][i].clone(), codes[1][i].clone()].concat()).collect()
    };
    let (one, two) = apart.split_at(apart.len() / 2);
    assert_eq!(encode(&apart, 2), [encode(one, 1), encode(two, 1)].concat());
}
