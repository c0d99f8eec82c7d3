//! The networks of the trainer, filled from the golden checkpoints, against the golden vectors
//! (ARCHITECTURE section 5), and back to the same weights.

use crate::common::{HEADS, codes, fixture, floats, gpt, vqvae};
use bailando_train::{
    checkpoint::TorchCheckpoint,
    nn::{Codebook, CriticNet, DecoderNet, GptNet, HalfNet, Parameters, Store},
    weights::{CriticWeights, HALF_JOINTS, HalfWeights},
};
use burn_flex::{Flex, FlexDevice};
use burn_tensor::{Int, Tensor, TensorData};
use ndarray::{Array1, Array2};

/// Largest difference to the golden vectors.
const TOLERANCE: f32 = 2e-5;
/// Blocks of the golden model's state network.
const BASE_LAYERS: usize = 2;

fn device() -> FlexDevice {
    FlexDevice
}

fn indices(codes: &[u32]) -> Tensor<Flex, 1, Int> {
    let codes: Vec<i32> = codes.iter().map(|&code| code as i32).collect();
    let length = codes.len();
    Tensor::from_data(TensorData::new(codes, [length]), &device())
}

/// The columns of `joints`, `[1, frames, columns]`.
fn half_motion(motion: &Array2<f32>, joints: &[usize]) -> Tensor<Flex, 3> {
    let mut values = Vec::new();
    for frame in motion.rows() {
        for &joint in joints {
            for column in 3 * joint..3 * joint + 3 {
                // The root's position is no input of the encoder.
                values.push(if joint == 0 { 0.0 } else { frame[column] });
            }
        }
    }
    let shape = [1, motion.nrows(), 3 * joints.len()];
    Tensor::from_data(TensorData::new(values, shape), &device())
}

fn flat(tensor: Tensor<Flex, 3>) -> Vec<f32> {
    tensor.into_data().iter::<f32>().collect()
}

#[test]
fn encoders_give_the_golden_codes() {
    let weights = vqvae();
    let motion: Array2<f32> = floats(&fixture("motion.npy"));
    let (upper, lower) = HALF_JOINTS;
    let half = |half: &HalfWeights, joints: &[usize]| {
        let mut store = Store::default();
        let net = HalfNet::new("half", half, &mut store);
        assert_eq!(net.encoder.weights(&store), half.encoder);
        let parameters = Parameters::from_store(&store, &device());
        let codebook = Codebook::new(&half.codebook, &device());
        let codes = net.encode(&parameters, &codebook, half_motion(&motion, joints));
        codes.into_data().iter::<u32>().collect::<Vec<_>>()
    };
    assert_eq!(half(&weights.upper, &upper), codes(&fixture("enc_up.npy")));
    assert_eq!(half(&weights.lower, &lower), codes(&fixture("enc_down.npy")));
}

#[test]
fn decoders_give_the_golden_motion() {
    let weights = vqvae();
    let golden: Array2<f32> = floats(&fixture("decode_raw.npy"));
    let (upper, lower) = HALF_JOINTS;
    let decode = |decoder, codebook, half: &str| {
        let mut store = Store::default();
        let net = DecoderNet::new("decoder", decoder, &mut store);
        assert_eq!(&net.weights(&store), decoder);
        let parameters = Parameters::from_store(&store, &device());
        let codes = indices(&codes(&fixture(&format!("codes_slide_{half}.npy"))));
        let codebook = Codebook::<Flex>::new(codebook, &device());
        flat(net.forward(&parameters, codebook.lookup(codes).unsqueeze_dim(0)))
    };
    let check = |found: &[f32], joints: &[usize], skip: usize| {
        let columns = 3 * joints.len();
        assert_eq!(found.len(), golden.nrows() * columns);
        for (frame, row) in found.chunks(columns).enumerate() {
            for (place, &joint) in joints.iter().enumerate().skip(skip) {
                for axis in 0..3 {
                    let (found, wanted) =
                        (row[3 * place + axis], golden[[frame, 3 * joint + axis]]);
                    let error = (found - wanted).abs();
                    assert!(error <= TOLERANCE, "frame {frame}, joint {joint}: {found} {wanted}");
                }
            }
        }
    };
    let found = decode(&weights.upper.decoder, &weights.upper.codebook, "up");
    check(&found, &upper, 0);
    // The root's own columns give way to the velocity.
    let found = decode(&weights.lower.decoder, &weights.lower.codebook, "down");
    check(&found, &lower, 1);
    check(&decode(&weights.root, &weights.lower.codebook, "down"), &[0], 0);
}

#[test]
fn the_gpt_gives_the_golden_logits() {
    let weights = gpt();
    let mut store = Store::default();
    let net = GptNet::new(&weights, &mut store);
    assert_eq!(net.weights(&store), weights);
    let parameters = Parameters::from_store(&store, &device());

    let (music, codes) = block_input(net.block());
    let logits = net.forward(&parameters, music, codes, 0.0);
    for (found, half) in [(logits.upper, "up"), (logits.lower, "down")] {
        let golden: Array2<f32> = floats(&fixture(&format!("block_logits_{half}.npy")));
        let found = flat(found);
        assert_eq!(found.len(), golden.len());
        for (place, (found, wanted)) in found.iter().zip(&golden).enumerate() {
            let error = (found - wanted).abs();
            assert!(error <= TOLERANCE, "{half} {place}: {found}, expected {wanted}");
        }
    }
}

#[test]
fn the_critic_gives_the_golden_values() {
    let mut checkpoint = TorchCheckpoint::open(&fixture("tiny_gpt.pt")).unwrap();
    let weights = CriticWeights::from_checkpoint(&mut checkpoint, HEADS).unwrap();
    let mut store = Store::default();
    let net = GptNet::new(&gpt(), &mut store);
    let critic = CriticNet::new(&weights, &mut store);
    assert_eq!(critic.weights(&store), weights);
    let parameters = Parameters::from_store(&store, &device());
    let (music, codes) = block_input(net.block());
    let states = net.states(&parameters, music, codes, BASE_LAYERS, 0.0);
    let found = critic.forward(&parameters, states).into_data();
    let golden: Array1<f32> = ndarray_npy::read_npy(fixture("critic_values.npy")).unwrap();
    assert_eq!(found.num_elements(), golden.len());
    for (found, wanted) in found.iter::<f32>().zip(&golden) {
        assert!((found - wanted).abs() <= TOLERANCE, "{found} {wanted}");
    }
}

/// Music and codes of a full block of the golden vectors.
fn block_input(steps: usize) -> (Tensor<Flex, 3>, [Tensor<Flex, 2, Int>; 2]) {
    let music: Array2<f32> = floats(&fixture("music.npy"));
    let columns = music.ncols();
    let rows = music.rows().into_iter().skip(1).take(steps);
    let rows: Vec<f32> = rows.flatten().copied().collect();
    let music = Tensor::from_data(TensorData::new(rows, [1, steps, columns]), &device());
    let half = |half: &str| {
        let codes = codes(&fixture(&format!("codes_slide_{half}.npy")));
        indices(&codes[..steps]).unsqueeze_dim::<2>(0)
    };
    (music, [half("up"), half("down")])
}
