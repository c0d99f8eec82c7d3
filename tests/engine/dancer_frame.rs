//! A model whose motion is in the dancer's frame, from its decoder to the served motion.

use bailando::{
    engine::{GenerationOptions, GenerationRequest},
    formats::Codes,
    model::{ModelDirectory, code_pairs},
    motion::MotionFrame,
};
use bailando_testkit::{arrays::assert_close, model::tiny_dancer};

use super::open;
use crate::support::music;

/// Turns are summed over a whole piece, and their rounding with them.
const TOLERANCE: f32 = 5e-4;

#[test]
fn a_dance_is_served_in_world_directions() {
    let engine = open(&tiny_dancer()).unwrap();
    // More than two chunks.
    let music = music(150, engine.manifest().features.columns);
    let options =
        GenerationOptions { seed: Some(1), temperature: Some(1.0), ..GenerationOptions::default() };
    let dance = engine.generate(GenerationRequest::features(music, options)).unwrap();
    let Codes { upper, lower } = dance.codes.clone();
    let motion = dance.into_decoded();
    assert_eq!(motion.dim(), (8 * upper.len(), 72));

    let directory = ModelDirectory::open(&tiny_dancer()).unwrap();
    let mut decoder = directory.decoder(1).unwrap();
    let whole = decoder.decode(&code_pairs(&upper, &lower).unwrap()).unwrap();
    let turned: f32 = whole.column(72).sum();
    println!("turned by {turned}");
    assert!(turned.abs() > 3.0, "a dance that does not turn tests nothing");
    let world = MotionFrame::Dancer.into_world(whole).unwrap();
    assert_close(&motion, &world, TOLERANCE, "chunks and at once");
}
