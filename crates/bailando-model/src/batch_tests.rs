//! The graphs serve any batch: a batch of two equals two single runs, bit by bit.

use bailando_testkit::{
    arrays::{codes, floats, rows},
    fixture,
    model::tiny,
};
use ndarray::Array2;
use ort::value::Tensor;

use super::{
    Device,
    session::{Graph, Inputs, SessionOptions},
};

const STEPS: usize = 6;
const LAYERS: usize = 4;
const HEADS: usize = 4;
const HEAD_SIZE: usize = 12;

/// Upper codes, lower codes and music rows of one sequence.
struct Sequence {
    halves: [Vec<i64>; 2],
    music: Array2<f32>,
}

fn graph(name: &'static str) -> Graph {
    let options = SessionOptions { device: Device::Cpu, threads: 1 };
    Graph::open(name, &tiny().join(format!("{name}.onnx")), options, false).unwrap()
}

fn golden(name: &str) -> std::path::PathBuf {
    fixture("model").join(name)
}

fn sequences() -> [Sequence; 2] {
    let halves = ["codes_slide_up.npy", "codes_slide_down.npy"].map(|name| codes(&golden(name)));
    let music = floats(&golden("music.npy"));
    [0, 20].map(|from| Sequence {
        halves: halves
            .each_ref()
            .map(|half| half[from..from + STEPS].iter().copied().map(i64::from).collect()),
        music: rows(&music, from..from + STEPS).to_owned(),
    })
}

/// The codes of all `sequences`, by the names of both halves.
fn codes_of(sequences: &[&Sequence]) -> Inputs<'static> {
    let half = |half: usize| {
        let codes: Vec<i64> =
            sequences.iter().flat_map(|one| one.halves[half].iter().copied()).collect();
        Tensor::from_array(([sequences.len(), STEPS], codes)).unwrap().into()
    };
    vec![("upper".into(), half(0)), ("lower".into(), half(1))]
}

/// Every output of one run over all `sequences` at once, flattened, per sequence.
fn run_gpt(gpt: &mut Graph, sequences: &[&Sequence]) -> Vec<Vec<f32>> {
    let batch = sequences.len();
    let music: Vec<f32> = sequences.iter().flat_map(|one| one.music.iter().copied()).collect();
    let positions: Vec<i64> = (0..batch).flat_map(|_| 0..STEPS as i64).collect();
    let tokens = 3 * STEPS;
    let mut inputs = codes_of(sequences);
    let mut add = |name: &str, shape: Vec<usize>, values: Vec<f32>| {
        inputs.push((name.to_owned(), Tensor::from_array((shape, values)).unwrap().into()));
    };
    add("music", vec![batch, STEPS, 438], music);
    // One mask for the whole batch.
    add("attention_bias", vec![1, 1, tokens, tokens], vec![0.0; tokens * tokens]);
    inputs.push((
        "positions".into(),
        Tensor::from_array(([batch, STEPS], positions)).unwrap().into(),
    ));
    for layer in 0..LAYERS {
        for kind in ["key", "value"] {
            let allocator = ort::memory::Allocator::default();
            let empty = Tensor::<f32>::new(&allocator, [batch, HEADS, 0, HEAD_SIZE]).unwrap();
            inputs.push((format!("past_{kind}.{layer}"), empty.into()));
        }
    }
    let mut rows = vec![Vec::new(); batch];
    let read = gpt.run(inputs, |outputs| {
        for (_, value) in &*outputs {
            let (_, values) = value.try_extract_tensor::<f32>().unwrap();
            for (row, part) in rows.iter_mut().zip(values.chunks(values.len() / batch)) {
                row.extend_from_slice(part);
            }
        }
        Ok(())
    });
    read.unwrap();
    rows
}

#[test]
fn the_gpt_runs_two_as_it_runs_each() {
    let mut gpt = graph("gpt");
    let [first, second] = sequences();
    let together = run_gpt(&mut gpt, &[&first, &second]);
    let apart = [&first, &second].map(|one| run_gpt(&mut gpt, &[one]).remove(0));
    assert_ne!(together[0], together[1]);
    // Logits of both halves, then keys and values of every layer.
    assert_eq!(apart[0].len(), 2 * STEPS * 16 + LAYERS * 2 * 3 * STEPS * HEADS * HEAD_SIZE);
    assert!(together == apart, "bitwise");
}

#[test]
fn decoder_and_encoder_run_two_as_they_run_each() {
    let (mut decoder, mut encoder) = (graph("decoder"), graph("encoder"));
    let mut decode = |sequences: &[&Sequence]| -> Vec<f32> {
        let decoded = decoder.run(codes_of(sequences), |outputs| {
            let (shape, motion) = outputs["motion"].try_extract_tensor::<f32>().unwrap();
            assert_eq!(**shape, [sequences.len() as i64, 8 * STEPS as i64, 72]);
            Ok(motion.to_vec())
        });
        decoded.unwrap()
    };
    let [first, second] = sequences();
    let together = decode(&[&first, &second]);
    let apart = [decode(&[&first]), decode(&[&second])];
    assert_eq!(together, apart.concat());

    // Codes of each half, sequence by sequence, so that batches can be compared with single runs.
    let mut encode = |motion: &[f32], batch: usize| -> [Vec<i64>; 2] {
        let motion = Tensor::from_array(([batch, 8 * STEPS, 72], motion.to_vec())).unwrap();
        let encoded = encoder.run(vec![("motion".into(), motion.into())], |outputs| {
            let half = |half: &str| outputs[half].try_extract_tensor::<i64>().unwrap().1.to_vec();
            Ok([half("upper"), half("lower")])
        });
        encoded.unwrap()
    };
    let [one, two] = apart.each_ref().map(|motion| encode(motion, 1));
    let both = [0, 1].map(|half| [one[half].clone(), two[half].clone()].concat());
    assert_eq!(encode(&together, 2), both);
}
