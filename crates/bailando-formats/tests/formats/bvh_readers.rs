//! BVH read by an independent parser (PyPI `bvhio`): world positions must be those of our forward
//! kinematics within a millimetre. Skipped, with one line, where Python or the package can't be
//! had.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use bailando_formats::{BvhUnit, GeneratedMotion, to_bvh};
use bailando_motion::{FinishOptions, Positions, forward};
use bailando_testkit::motion::{dance_of, decoded_from, distances, recordings};
use serde::Deserialize;

use crate::motion;

/// Pinned: the versions this test was seen to pass with.
const PACKAGES: [&str; 4] =
    ["bvhio==1.5.4", "spatial-transform==1.3.3", "PyGLM==2.8.2", "numpy==2.4.6"];
/// Longest wait for the environment; an unreachable index must not hold up the tests.
const INSTALL_LIMIT: Duration = Duration::from_secs(120);
/// A millimetre: a rigger would not see it.
const TOLERANCE: f64 = 1e-3;

#[test]
fn an_independent_parser_sees_our_positions() {
    let python = match environment() {
        Ok(python) => python,
        Err(reason) => {
            println!("skipped: an_independent_parser_sees_our_positions needs bvhio: {reason}");
            return;
        }
    };
    check(&python, "untrained", &motion(60), BvhUnit::Centimetre);
    check(&python, "metres", &motion(20), BvhUnit::Metre);
    if let Some(folder) = bailando_testkit::shared("data/salsa") {
        let (_, recording) = recordings(&folder).swap_remove(0);
        let options = FinishOptions { fps: 30, ..FinishOptions::default() };
        let motion = dance_of(&decoded_from(&recording), &options);
        check(&python, "recording", &motion, BvhUnit::Centimetre);
    }
}

#[derive(Deserialize)]
struct Seen {
    names: Vec<String>,
    frame_time: f64,
    positions: Vec<Vec<[f64; 3]>>,
}

fn check(python: &Path, name: &str, motion: &GeneratedMotion, unit: BvhUnit) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("dance.bvh");
    std::fs::write(&file, to_bvh(motion, unit).unwrap()).unwrap();
    let script = bailando_testkit::project("tests/python/read_bvh.py");
    let read = Command::new(python).arg(script).arg(&file).output().unwrap();
    let errors = String::from_utf8_lossy(&read.stderr);
    assert!(read.status.success(), "{name}: {errors}");
    let seen: Seen = serde_json::from_slice(&read.stdout).unwrap();

    let fps = f64::from(motion.animation.fps);
    assert!((seen.frame_time * fps - 1.0).abs() < 1e-5);
    let ours = forward(&motion.skeleton, &motion.animation).unwrap();
    assert_eq!(seen.positions.len(), ours.dim().0);
    let metre = match unit {
        BvhUnit::Centimetre => 100.0,
        BvhUnit::Metre => 1.0,
    };
    let theirs = Positions::from_shape_fn(ours.dim(), |(frame, joint, axis)| {
        let name = &motion.skeleton.joints[joint];
        let index = seen.names.iter().position(|n| n == name).unwrap();
        (seen.positions[frame][index][axis] / metre) as f32
    });
    let (mean, largest) = distances(&theirs, &ours);
    let frames = ours.dim().0;
    println!("bvhio, {name}: {frames} frames, mean {mean:.2e} m, largest {largest:.2e} m");
    assert!(largest < TOLERANCE, "{name}: {largest} m");
}

/// Makes a Python environment under `target/`, once.
fn environment() -> Result<PathBuf, String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bvh-python");
    let bin = if cfg!(windows) { "Scripts" } else { "bin" };
    let python = folder.join(bin).join("python");
    let works = |python: &Path| run(python, &["-c", "import bvhio"]).is_ok();
    if python.exists() && works(&python) {
        return Ok(python);
    }
    let folder = folder.to_str().ok_or("the folder's name is not UTF-8")?;
    run(Path::new("python3"), &["-m", "venv", "--clear", folder])?;
    let install = "-m pip install --quiet --disable-pip-version-check --retries 1 --timeout 10";
    let arguments: Vec<&str> = install.split(' ').chain(PACKAGES).collect();
    run(&python, &arguments)?;
    if works(&python) { Ok(python) } else { Err("it was installed but can't be imported".into()) }
}

/// Runs a program quietly, for no longer than [`INSTALL_LIMIT`].
fn run(program: &Path, arguments: &[&str]) -> Result<(), String> {
    let name = program.display();
    let mut child = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|error| format!("{name}: {error}"))?;
    let started = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(status)) => return Err(format!("{name}: {status}")),
            Ok(None) if started.elapsed() < INSTALL_LIMIT => {
                std::thread::sleep(Duration::from_millis(50));
            }
            Ok(None) => {
                // Already gone or not ours to wait for: either way there is nothing left to do.
                let _ = child.kill();
                let _ = child.wait();
                return Err(format!("{name}: still running after {INSTALL_LIMIT:?}"));
            }
            Err(error) => return Err(format!("{name}: {error}")),
        }
    }
}
