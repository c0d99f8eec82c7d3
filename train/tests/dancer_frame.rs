//! A model whose motion is in the dancer's frame, from weights to the served dance: the golden
//! model with a root's decoder that turns as well.

use crate::common;
use std::{fs, path::Path};

use crate::common::{assert_close, gpt, options, vqvae};
use bailando::{
    codebook::{Catalogue, Half, Order},
    engine::{
        Engine, EngineConfig, EngineError, GenerationOptions, GenerationOutput, GenerationRequest,
    },
    formats::Codes,
    model::{Manifest, ModelDirectory, code_pairs},
    motion::{MotionFrame, to_world_frame},
};
use bailando_train::{
    HostTensor,
    export::{ExportError, write_model_directory},
    nn::{Codebook, DecoderNet, Parameters, Store},
    onnx::InputRanges,
    weights::{Convolution, DecoderWeights, HALF_JOINTS, VqVaeWeights},
};
use burn_flex::{Flex, FlexDevice};
use burn_tensor::{Int, Tensor, TensorData};
use ndarray::Array2;

/// Turns are summed over a whole piece, and their rounding with them.
const TOLERANCE: f32 = 5e-4;

/// The golden weights with a fourth row in the root's decoder, a turn to and fro.
fn turning() -> VqVaeWeights {
    let mut weights = vqvae();
    let Convolution { weight, bias } = &weights.root.output;
    let (mut values, mut offsets) = (weight.data().to_vec(), bias.data().to_vec());
    let row = values.len() / 3;
    values.extend((0..row).map(|place| 0.1 * (place as f32 * 1.7).sin()));
    offsets.push(0.01);
    let shape = vec![4, weight.dim(1), weight.dim(2)];
    weights.root.output = Convolution {
        weight: HostTensor::new(shape, values).unwrap(),
        bias: HostTensor::new(vec![4], offsets).unwrap(),
    };
    weights
}

fn write(weights: &VqVaeWeights, frame: MotionFrame, out: &Path) -> Result<Manifest, ExportError> {
    let gpt = gpt();
    let mut description = options(Path::new(""), Path::new(""), out).description;
    description.motion_frame = frame;
    write_model_directory(out, false, &gpt, &InputRanges::default(), weights, &description)
}

fn open(model: &Path) -> Result<Engine, EngineError> {
    Engine::open(&EngineConfig { threads: 1, ..EngineConfig::new(model) })
}

/// A dance of more than two chunks.
fn dance(engine: &Engine) -> GenerationOutput {
    let music = Array2::from_shape_fn((150, 438), |(row, column)| {
        ((row * 31 + column * 7) % 97) as f32 / 97.0 - 0.5
    });
    let options =
        GenerationOptions { seed: Some(1), temperature: Some(1.0), ..GenerationOptions::default() };
    engine.generate(GenerationRequest::features(music, options)).unwrap()
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
fn decoded_by_networks(weights: &VqVaeWeights, upper: &[u32], lower: &[u32]) -> Array2<f32> {
    let root = network(&weights.root, &weights.lower.codebook, lower);
    let mut motion = Array2::zeros((root.nrows(), 73));
    let (upper_joints, lower_joints) = HALF_JOINTS;
    for (half, joints, codes) in
        [(&weights.upper, &upper_joints[..], upper), (&weights.lower, &lower_joints[..], lower)]
    {
        let columns = network(&half.decoder, &half.codebook, codes);
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
fn a_dance_is_served_in_world_directions() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model");
    let weights = turning();
    write(&weights, MotionFrame::Dancer, &model).unwrap();
    let dance = dance(&open(&model).unwrap());
    let Codes { upper, lower } = &dance.codes.clone();
    let motion = dance.into_decoded();
    assert_eq!(motion.dim(), (8 * upper.len(), 72));

    let own = decoded_by_networks(&weights, upper, lower);
    let turned: f32 = own.column(72).sum();
    println!("turned by {turned}");
    assert!(turned.abs() > 3.0, "a dance that does not turn tests nothing");
    let world = to_world_frame(own.view()).unwrap();
    assert_close(&motion, &world, TOLERANCE, "served from chunks");

    let directory = ModelDirectory::open(&model).unwrap();
    let mut decoder = directory.decoder(1).unwrap();
    let whole = decoder.decode(&code_pairs(upper, lower).unwrap()).unwrap();
    assert_close(&whole, &own, common::TOLERANCE, "decoder.onnx");
    let world = MotionFrame::Dancer.into_world(whole).unwrap();
    assert_close(&motion, &world, TOLERANCE, "chunks and at once");
}

#[test]
fn the_manifest_says_the_frame_only_where_it_is_the_dancers() {
    let folder = tempfile::tempdir().unwrap();
    for (weights, frame, line) in
        [(vqvae(), MotionFrame::World, None), (turning(), MotionFrame::Dancer, Some("dancer"))]
    {
        let model = folder.path().join(format!("{frame:?}"));
        let written = write(&weights, frame, &model).unwrap();
        let read = ModelDirectory::open(&model).unwrap();
        assert_eq!(read.manifest(), &written);
        assert_eq!(read.manifest().motion_frame, frame);
        let text = fs::read(model.join("manifest.json")).unwrap();
        let json: serde_json::Value = serde_json::from_slice(&text).unwrap();
        let found = json.get("motion_frame").and_then(|value| value.as_str());
        assert_eq!(found, line);
    }
}

/// Manifests from before there was a choice of frame, counts or candidates, and their hashes, stay
/// what they are.
#[test]
fn the_first_manifest_is_unchanged_by_reading_and_writing() {
    let manifest = unchanged("../tests/fixtures/model/manifest_of_the_first_model.json");
    assert_eq!(manifest.motion_frame, MotionFrame::World);
    assert_eq!(manifest.decoded_columns(), 72);
    assert_eq!((manifest.sampling.guidance, manifest.sampling.candidates), (1.0, 1));
}

#[test]
fn the_shipped_manifest_is_unchanged_by_reading_and_writing() {
    let manifest = unchanged("../models/default/manifest.json");
    assert_eq!(manifest.motion_frame, MotionFrame::Dancer);
}

/// The manifest of a file of this package, which is the same text when it is written again.
fn unchanged(file: &str) -> Manifest {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    let text = fs::read_to_string(path).unwrap();
    let manifest: Manifest = serde_json::from_str(&text).unwrap();
    let again = serde_json::to_string_pretty(&manifest).unwrap() + "\n";
    assert_eq!(again, text);
    manifest
}

#[test]
fn a_manifest_with_the_wrong_frame_is_refused_at_start() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model");
    write(&turning(), MotionFrame::Dancer, &model).unwrap();
    let path = model.join("manifest.json");
    let honest = fs::read_to_string(&path).unwrap();
    for (frame, problem) in
        [("world", "motion has 73 columns, expected 72"), ("moon", "unknown variant `moon`")]
    {
        fs::write(&path, honest.replace("\"dancer\"", &format!("\"{frame}\""))).unwrap();
        let error = open(&model).unwrap_err().to_string();
        assert!(error.contains(problem), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn weights_of_another_frame_are_not_exported() {
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
        let error = write(&weights, frame, &model).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

/// Poses are those that are decoded, not yet turned; a code faces no way, so it has no dial.
#[test]
fn its_codebook_shows_poses_that_face_the_front() {
    let folder = tempfile::tempdir().unwrap();
    let (world, dancer) = (folder.path().join("world"), folder.path().join("dancer"));
    write(&vqvae(), MotionFrame::World, &world).unwrap();
    write(&turning(), MotionFrame::Dancer, &dancer).unwrap();
    let [world, dancer] = [world, dancer].map(|model| {
        let directory = ModelDirectory::open(&model).unwrap();
        Catalogue::new(&directory, 1, None, 3).unwrap()
    });
    for half in [Half::Upper, Half::Lower] {
        for (plain, turning) in world.half(half).codes.iter().zip(&dancer.half(half).codes) {
            assert_eq!(plain.pose, turning.pose);
        }
        let circles = |catalogue: &Catalogue| {
            let svg = catalogue.sheet(half, 4, Order::Number).unwrap();
            svg.matches("<circle ").count()
        };
        assert_eq!(circles(&world), 2 * circles(&dancer));
    }
}
