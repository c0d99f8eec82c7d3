//! Motions for integration tests. Unit tests of `bailando-motion` and `bailando-formats` cannot use
//! them: their own types differ from those that this crate was built with.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use bailando_formats::{Codes, GeneratedMotion, MusicInfo, Timings};
use bailando_motion::{FinishOptions, Skeleton, finish};
use ndarray::{Array2, Array3};

use crate::arrays::load;

/// Returns the skeleton of the motion that models are trained on.
pub fn skeleton() -> Skeleton {
    serde_json::from_str(include_str!("../../../tests/fixtures/motion/skeleton.json")).unwrap()
}

/// Reads a float32 matrix of `tests/fixtures/model`.
pub fn fixture(name: &str) -> Array2<f32> {
    load(&crate::fixture("model").join(name))
}

/// Reads all recordings in the folder of a data set.
pub fn recordings(folder: &Path) -> Vec<(PathBuf, Array3<f32>)> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "npy"))
        .collect();
    paths.sort();
    assert!(!paths.is_empty(), "no motions in {}", folder.display());
    let read = |path: PathBuf| (path.clone(), load(&path));
    paths.into_iter().map(read).collect()
}

/// Returns a perfect decoder's output for a recording: root velocity in columns 0..3, the other
/// joints relative to the root.
pub fn decoded_from(positions: &Array3<f32>) -> Array2<f32> {
    let (frames, joints, _) = positions.dim();
    Array2::from_shape_fn((frames, 3 * joints), |(frame, column)| {
        let (joint, axis) = (column / 3, column % 3);
        if joint == 0 {
            let from = frame.min(frames.saturating_sub(2));
            positions[[(from + 1).min(frames - 1), 0, axis]] - positions[[from, 0, axis]]
        } else {
            positions[[frame, joint, axis]] - positions[[frame, 0, axis]]
        }
    })
}

/// Returns mean and largest distance of joints, metres.
pub fn distances(a: &Array3<f32>, b: &Array3<f32>) -> (f64, f64) {
    assert_eq!(a.dim(), b.dim());
    let (mut sum, mut largest) = (0.0_f64, 0.0_f64);
    for (pose_a, pose_b) in a.outer_iter().zip(b.outer_iter()) {
        for (joint_a, joint_b) in pose_a.outer_iter().zip(pose_b.outer_iter()) {
            let axes = joint_a.iter().zip(&joint_b);
            let squares: f64 = axes.map(|(a, b)| f64::from(a - b).powi(2)).sum();
            let distance = squares.sqrt();
            sum += distance;
            largest = largest.max(distance);
        }
    }
    let (frames, joints, _) = a.dim();
    (sum / (frames * joints) as f64, largest)
}

/// Returns a generated dance whose decoder gave `decoded`.
pub fn dance_of(decoded: &Array2<f32>, options: &FinishOptions) -> GeneratedMotion {
    let done = finish(decoded.view(), &skeleton(), options).unwrap();
    let codes = decoded.dim().0 as u32 / 8;
    GeneratedMotion {
        model: "tiny".into(),
        seed: 7,
        skeleton: skeleton(),
        animation: done.animation,
        positions: done.positions,
        positions_source: done.source,
        codes: Codes {
            upper: (0..codes).map(|k| k % 5).collect(),
            lower: (0..codes).map(|k| k % 3).collect(),
        },
        style: Some("pop".into()),
        music: Some(MusicInfo {
            tempo_bpm: 104.0,
            tempo_steady: true,
            beats_s: vec![0.5, 1.0769],
            downbeats_s: vec![0.5],
            metre: 4,
            confidence: 0.9,
        }),
        timings: Timings { inference: Duration::from_micros(12_345), ..Timings::default() },
        warnings: vec!["0.1 s of silence were trimmed".into()],
        song_start_s: 2.5,
        continuation: None,
    }
}

/// Writes a folder of six reference motions and one of three generated ones, named like three of
/// them.
pub fn folders() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let [reference, generated] = ["reference", "generated"].map(|name| folder.path().join(name));
    for (path, count, offset) in [(&reference, 6, 0.0), (&generated, 3, 0.25)] {
        std::fs::create_dir(path).unwrap();
        for at in 0..count {
            let motion = sway(400, 2.0 + 0.5 * at as f32 + offset);
            write_motion(&path.join(format!("song{at}.npy")), &motion);
        }
    }
    (folder, reference, generated)
}

/// Writes a motion `[frames, joints, 3]` as a NumPy file.
pub fn write_motion(path: &Path, positions: &Array3<f32>) {
    ndarray_npy::write_npy(path, positions).unwrap();
}

/// Returns a motion of sways, one per joint and axis, at some pace.
pub fn sway(frames: usize, pace: f32) -> Array3<f32> {
    Array3::from_shape_fn((frames, 24, 3), |(frame, joint, axis)| {
        let t = frame as f32 / 60.0;
        let phase = joint as f32 * 0.7 + axis as f32 * 1.3;
        (pace * t + phase).sin() * 0.3 + phase.cos()
    })
}
