//! Writes a motion that was kept as JSON (with `include=rotations`) in another format, or on a
//! character: `cargo run -p bailando-formats --example convert -- dance.json dance.glb [mixamo]`,
//! or `dance.json hero-dance.glb hero.glb`.

use std::{error::Error, io::Write, path::Path, time::Instant};

use bailando_formats::{
    Character, Codes, GeneratedMotion, OutputFormat, PositionsSource, RigLimits, RigMapping,
    TargetSkeleton, Timings, WriteOptions,
};
use bailando_motion::{Animation, Skeleton, forward};
use glam::{Quat, Vec3};
use serde::Deserialize;

#[derive(Deserialize)]
struct Kept {
    model: String,
    seed: u64,
    fps: u32,
    skeleton: Bones,
    rotations: Vec<Vec<[f32; 4]>>,
    root: Vec<[f32; 3]>,
}

#[derive(Deserialize)]
struct Bones {
    joints: Vec<String>,
    parents: Vec<i32>,
    offsets: Vec<[f32; 3]>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [from, to, ..] = arguments.as_slice() else {
        return Err("usage: convert DANCE.json OUT [SKELETON or RIG.{bvh,glb,vrm}]".into());
    };
    let third = arguments.get(2).map_or("smpl", String::as_str);
    let motion = motion(serde_json::from_slice(&std::fs::read(from)?)?)?;
    let started = Instant::now();
    let file = if Path::new(third).is_file() {
        let (mapping, limits) = (RigMapping::default(), RigLimits::default());
        Character::read(std::fs::read(third)?, &mapping, &limits)?.dance(&motion, true)?
    } else {
        let skeleton: TargetSkeleton = third.parse()?;
        let format: OutputFormat = to.rsplit('.').next().unwrap_or_default().parse()?;
        format.write(&motion, &WriteOptions { skeleton, ..WriteOptions::default() })?
    };
    let taken = started.elapsed();
    let (bytes, milliseconds) = (file.len(), taken.as_secs_f64() * 1e3);
    std::fs::write(to, file)?;
    Ok(writeln!(std::io::stderr(), "{to}: {bytes} bytes in {milliseconds:.1} ms")?)
}

fn motion(kept: Kept) -> Result<GeneratedMotion, Box<dyn Error>> {
    let Bones { joints, parents, offsets } = kept.skeleton;
    // The height at which a dance starts is not kept, and no format needs it.
    let skeleton = Skeleton { joints, parents, offsets, root_height: 0.0 };
    let turn = |q| Quat::from_array(q).normalize();
    let animation = Animation {
        fps: kept.fps,
        root: kept.root.into_iter().map(Vec3::from).collect(),
        rotations: kept.rotations.into_iter().map(|f| f.into_iter().map(turn).collect()).collect(),
    };
    Ok(GeneratedMotion {
        model: kept.model,
        seed: kept.seed,
        positions: forward(&skeleton, &animation)?,
        skeleton,
        animation,
        positions_source: PositionsSource::ForwardKinematics,
        codes: Codes::default(),
        style: None,
        music: None,
        timings: Timings::default(),
        warnings: Vec::new(),
        song_start_s: 0.0,
        continuation: None,
    })
}
