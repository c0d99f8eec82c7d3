//! What is exported: graphs that give what the trainer's networks give, stored as asked for, and
//! weights that do not fit each other refused.

use std::{fs, path::Path};

use crate::common::{
    TOLERANCE, assert_close, codes, dancer::turning, fixture, floats, gpt, imported, options, rows,
    vqvae,
};
use bailando::{
    model::{Gpt, Logits, Manifest, ModelDirectory, NextStep, Steps, WeightStorage, code_pairs},
    motion::{MotionFrame, to_world_frame},
};
use bailando_testkit::model::tiny;
use bailando_train::{
    HostTensor,
    export::{ExportError, write_model_directory},
    nn::{Codebook, DecoderNet, Parameters, Store},
    onnx::InputRanges,
    weights::{DecoderWeights, GptWeights, HALF_JOINTS, VqVaeWeights},
};
use burn_flex::{Flex, FlexDevice};
use burn_tensor::{Int, Tensor, TensorData};
use ndarray::Array2;

fn exact() -> ModelDirectory {
    ModelDirectory::open(&tiny()).unwrap()
}

/// Codes of a golden sampling.
fn golden_codes() -> Vec<[u32; 2]> {
    let [upper, lower] =
        ["up", "down"].map(|half| codes(&fixture(&format!("codes_slide_{half}.npy"))));
    code_pairs(&upper, &lower).unwrap()
}

fn size(directory: &ModelDirectory, file: &str) -> u64 {
    directory.manifest().files[file].bytes
}

#[test]
fn half_precision_weights_stay_close() {
    let exact = exact();
    let (_folder, halved) = imported(|options| options.description.weights = WeightStorage::F16);
    assert!(size(&halved, "decoder.onnx") * 10 < size(&exact, "decoder.onnx") * 7);
    let codes = golden_codes();
    let decode = |model: &ModelDirectory| model.decoder(1).unwrap().decode(&codes).unwrap();
    let difference = (decode(&exact) - decode(&halved)).mapv(f32::abs);
    let worst = difference.iter().copied().fold(0.0_f32, f32::max);
    assert!(worst > 0.0 && worst < 1e-2, "{worst}");
}

/// Logits of the golden codes, step by step after four that were computed at once.
fn stepped(gpt: &mut Gpt) -> Vec<Logits> {
    const PREFILLED: usize = 4;
    let (codes, music) = (golden_codes(), floats(&fixture("music.npy")));
    let mut cache = gpt.cache(1);
    let steps = Steps { codes: &codes[..PREFILLED], music: rows(&music, 1..PREFILLED + 1) };
    gpt.prefill(&mut cache, 0, steps).unwrap();
    let steps = (PREFILLED..20).map(|step| {
        let next = NextStep { codes: codes[step], music: music.row(step + 1) };
        gpt.step(&mut cache, &[next]).unwrap()
    });
    steps.collect()
}

#[test]
fn eight_bit_matrices_stay_close_and_smaller() {
    let exact = exact();
    let (_folder, small) = imported(|options| options.description.weights = WeightStorage::Int8);
    assert!(size(&small, "gpt.onnx") < size(&exact, "gpt.onnx") / 2);
    let [exact, small] = [exact, small].map(|model| stepped(&mut model.gpt(1).unwrap()));
    for (exact, small) in exact.iter().zip(&small) {
        for (exact, small) in [(&exact.upper, &small.upper), (&exact.lower, &small.lower)] {
            let error = (exact - small).mapv(|x| x * x).sum().sqrt();
            let size = exact.mapv(|x| x * x).sum().sqrt();
            // Logits of a toy with 48 channels, where little cancels out.
            assert!(error > 0.0 && error < 0.15 * size, "{error} of {size}");
        }
    }
}

/// Exports beside a motion frame.
fn write(
    gpt: &GptWeights,
    weights: &VqVaeWeights,
    frame: MotionFrame,
    out: &Path,
) -> Result<Manifest, ExportError> {
    let mut description = options(Path::new(""), Path::new(""), out).description;
    description.motion_frame = frame;
    write_model_directory(out, false, gpt, &InputRanges::default(), weights, &description)
}

#[test]
fn a_model_of_two_trainings_is_refused() {
    let mut gpt = gpt();
    for table in [&mut gpt.upper_embedding, &mut gpt.upper_head] {
        let twice = [table.data(), table.data()].concat();
        *table = HostTensor::new(vec![32, table.dim(1)], twice).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("model");
    let refused = write(&gpt, &vqvae(), MotionFrame::World, &out);
    assert_eq!(
        refused.unwrap_err().to_string(),
        "the GPT has 32 upper codes, but the VQ-VAE's codebook has 16: are they of the same model?"
    );
    assert!(!out.exists());
}

#[test]
fn weights_of_another_frame_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model");
    for (weights, frame, expected) in [
        (
            vqvae(),
            MotionFrame::Dancer,
            "the root's decoder gives 3 columns, but motion in the dancer's frame has 4",
        ),
        (
            turning(),
            MotionFrame::World,
            "the root's decoder gives 4 columns, but motion in the world's frame has 3",
        ),
    ] {
        let error = write(&gpt(), &weights, frame, &model).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

/// What the trainer's network makes of `codes`, `[frames, columns]`.
fn network(decoder: &DecoderWeights, codebook: &HostTensor, codes: &[u32]) -> Array2<f32> {
    let mut store = Store::default();
    let net = DecoderNet::new("decoder", decoder, &mut store);
    let parameters = Parameters::<Flex>::from_store(&store, &FlexDevice);
    let indices: Vec<i32> = codes.iter().map(|&code| code as i32).collect();
    let shape = [indices.len()];
    let indices = Tensor::<Flex, 1, Int>::from_data(TensorData::new(indices, shape), &FlexDevice);
    let entries = Codebook::<Flex>::new(codebook, &FlexDevice).lookup(indices);
    let motion = net.forward(&parameters, entries.unsqueeze_dim(0));
    let [_, frames, columns] = motion.dims();
    let values = motion.into_data().iter::<f32>().collect();
    Array2::from_shape_vec((frames, columns), values).unwrap()
}

/// The dancer's columns of a whole piece by the trainer's networks alone.
fn decoded_by_networks(weights: &VqVaeWeights, codes: &[[u32; 2]]) -> Array2<f32> {
    let [upper, lower] = [0, 1].map(|half| codes.iter().map(|pair| pair[half]).collect::<Vec<_>>());
    let root = network(&weights.root, &weights.lower.codebook, &lower);
    let mut motion = Array2::zeros((root.nrows(), 73));
    let (upper_joints, lower_joints) = HALF_JOINTS;
    for (half, joints, codes) in
        [(&weights.upper, &upper_joints[..], upper), (&weights.lower, &lower_joints[..], lower)]
    {
        let columns = network(&half.decoder, &half.codebook, &codes);
        for (place, &joint) in joints.iter().enumerate() {
            for axis in 0..3 {
                let found = columns.column(3 * place + axis);
                motion.column_mut(3 * joint + axis).assign(&found);
            }
        }
    }
    for (column, found) in [0, 1, 2, 72].into_iter().zip(root.columns()) {
        motion.column_mut(column).assign(&found);
    }
    motion
}

#[test]
fn motion_in_the_dancers_frame_is_that_of_the_networks() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model");
    let weights = turning();
    let written = write(&gpt(), &weights, MotionFrame::Dancer, &model).unwrap();
    let directory = ModelDirectory::open(&model).unwrap();
    assert_eq!(directory.manifest(), &written);
    let codes = golden_codes().repeat(3);
    let own = decoded_by_networks(&weights, &codes);
    let decoded = directory.decoder(1).unwrap().decode(&codes).unwrap();
    assert_close(&decoded, &own, TOLERANCE, "decoder.onnx");
    let [own, decoded] = [own, decoded].map(|motion| to_world_frame(motion.view()).unwrap());
    // Turns are summed over a whole piece, and their rounding with them.
    assert_close(&decoded, &own, 5e-4, "in the world's frame");
}
