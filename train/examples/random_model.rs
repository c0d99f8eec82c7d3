//! Writes a model directory of the published size with random weights, to measure speed and memory
//! where the published weights are not at hand. Its motion is noise.
//!
//! `cargo run --release -p bailando-train --example random_model -- OUT [f32|f16|int8]`

use std::{collections::BTreeMap, path::Path};

use anyhow::Context;
use bailando::{
    features::Profile,
    model::{CountSource, SuppressedCodes, WeightStorage},
    motion::MotionFrame,
};
use bailando_train::{
    HostTensor,
    export::{Description, PUBLISHED_HOP, write_model_directory},
    nn::{GptSizes, VqVaeSizes, random_gpt, random_vqvae},
    onnx::InputRanges,
    weights::HALF_JOINTS,
};

const CODES: usize = 512;
const WIDTH: usize = 512;
const SEED: u64 = 1;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: random_model OUT [f32|f16|int8]";
    let out = arguments.next().context(usage)?;
    let weights = match arguments.next().as_deref() {
        None | Some("f32") => WeightStorage::F32,
        Some("f16") => WeightStorage::F16,
        Some("int8") => WeightStorage::Int8,
        Some(_) => anyhow::bail!(usage),
    };
    // ARCHITECTURE sections 2 and 3.
    let gpt = random_gpt(
        GptSizes {
            channels: 768,
            heads: 12,
            layers: 6 + 6,
            block: 29,
            codes: [CODES, CODES],
            columns: 438,
        },
        SEED,
    );
    let (upper, lower) = HALF_JOINTS;
    let mut vqvae = random_vqvae(
        VqVaeSizes {
            width: WIDTH,
            embedding: WIDTH,
            codes: CODES,
            half_columns: [3 * upper.len(), 3 * lower.len()],
            root_columns: 3,
        },
        SEED,
    );
    for half in [&mut vqvae.upper, &mut vqvae.lower] {
        // Entries of a trainer's codebook are zero before the first batch.
        let values = (0..CODES * WIDTH).map(|place| (place as f32 * 0.7).sin());
        half.codebook = HostTensor::new(vec![CODES, WIDTH], values.collect())?;
    }
    let description = Description {
        name: "random-published-size".into(),
        licence: "MIT".into(),
        profile: Profile::Librosa011,
        count_periods: Vec::new(),
        counts: CountSource::default(),
        styles: Vec::new(),
        energy: false,
        classifier: None,
        start_codes: Vec::new(),
        style_start_codes: BTreeMap::new(),
        style_codes: BTreeMap::new(),
        suppressed_codes: SuppressedCodes::default(),
        temperature: 1.0,
        guidance: 1.0,
        candidates: 1,
        redo: false,
        hop: PUBLISHED_HOP,
        motion_frame: MotionFrame::World,
        root_height: 0.93,
        weights,
        training: BTreeMap::new(),
    };
    let ranges = InputRanges::default();
    write_model_directory(Path::new(&out), false, &gpt, &ranges, &vqvae, &description)?;
    Ok(())
}
