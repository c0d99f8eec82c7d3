//! A dance without a server: the engine in your own program.
//!
//! ```text
//! cargo run --release --example library -- song.mp3 dance.glb
//! ```

#![expect(clippy::print_stdout, reason = "an example tells what it has done")]

use std::{env, fs};

use anyhow::{Context, Result};
use bailando::{
    audio::AudioRange,
    engine::{Engine, EngineConfig, GenerationOptions, GenerationRequest},
    formats::{OutputFormat, TargetSkeleton, WriteOptions},
};

fn main() -> Result<()> {
    let mut arguments = env::args().skip(1);
    let (Some(song), Some(out)) = (arguments.next(), arguments.next()) else {
        anyhow::bail!("usage: library SONG OUT.glb");
    };
    // Loaded once; clones of the handle share the model, and requests share its steps.
    let engine = Engine::open(&EngineConfig::new("models/default"))?;
    let options = GenerationOptions {
        seed: Some(7),
        range: AudioRange { offset_s: 0.0, duration_s: Some(8.0) },
        music: true,
        ..GenerationOptions::default()
    };
    let audio = fs::read(&song).with_context(|| song.clone())?;
    // In async code: `engine.submit(request).await`; dropping that future cancels the work.
    let output = engine.generate(GenerationRequest::audio(audio, options))?;
    let motion = output.into_motion(engine.manifest());

    let seconds = motion.animation.root.len() as f64 / f64::from(motion.animation.fps);
    println!("{seconds} s of {} joints, seed {}", motion.skeleton.joints.len(), motion.seed);
    if let Some(music) = &motion.music {
        println!("{:.0} beats a minute, {} beats", music.tempo_bpm, music.beats_s.len());
    }
    let write = WriteOptions { skeleton: TargetSkeleton::Mixamo, ..WriteOptions::default() };
    let file = OutputFormat::Glb.write(&motion, &write)?;
    fs::write(&out, file).with_context(|| out.clone())
}
