//! Distance of BVH's constant-length skeleton from the model's own joint positions:
//!
//! ```text
//! cargo run --release --example skeleton_distance -- song.mp3 [SEEDS]
//! ```
//!
//! Prints mean and largest distance over all joints and frames of SEEDS dances (default 5), as they
//! are written, and with both roots put in one place.

use anyhow::{Context, Result};
use bailando::{
    engine::{Engine, EngineConfig, GenerationOptions, GenerationRequest},
    formats::GeneratedMotion,
    motion::{PositionsSource, forward},
};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let song = arguments.next().context("which song?")?;
    let seeds: u64 = arguments.next().map_or(Ok(5), |text| text.parse())?;
    let audio = std::fs::read(&song).with_context(|| song.clone())?;
    let engine = Engine::open(&EngineConfig::new("models/default"))?;
    let (mut as_written, mut root_fixed) = (Distances::default(), Distances::default());
    for seed in 0..seeds {
        let options = GenerationOptions {
            seed: Some(seed),
            clean: false,
            positions: PositionsSource::Decoder,
            ..GenerationOptions::default()
        };
        let output = engine.generate(GenerationRequest::audio(audio.clone(), options))?;
        let dance = output.into_motion(engine.manifest());
        measure(&dance, &mut as_written, &mut root_fixed)?;
    }
    as_written.print("as written");
    root_fixed.print("roots in one place");
    Ok(())
}

fn measure(
    dance: &GeneratedMotion,
    as_written: &mut Distances,
    root_fixed: &mut Distances,
) -> Result<()> {
    let skeleton = forward(&dance.skeleton, &dance.animation)?;
    for (decoded, posed) in dance.positions.outer_iter().zip(skeleton.outer_iter()) {
        for (a, b) in decoded.outer_iter().zip(posed.outer_iter()) {
            let apart = |axis: usize| a[axis] - b[axis];
            let root_apart = |axis: usize| decoded[[0, axis]] - posed[[0, axis]];
            as_written.add([0, 1, 2].map(apart));
            root_fixed.add([0, 1, 2].map(|axis| apart(axis) - root_apart(axis)));
        }
    }
    Ok(())
}

#[derive(Default)]
struct Distances {
    sum: f64,
    largest: f64,
    count: usize,
}

impl Distances {
    fn add(&mut self, difference: [f32; 3]) {
        let squares = difference.map(|d| f64::from(d).powi(2));
        let length = squares.iter().sum::<f64>().sqrt();
        self.sum += length;
        self.largest = self.largest.max(length);
        self.count += 1;
    }

    #[expect(clippy::print_stdout, reason = "printing is what this example is for")]
    fn print(&self, what: &str) {
        let mean = 100.0 * self.sum / self.count as f64;
        println!("{what}: mean {mean:.2} cm, largest {:.1} cm", 100.0 * self.largest);
    }
}
