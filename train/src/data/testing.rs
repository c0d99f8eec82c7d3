//! Small synthetic data: a swaying figure and a click track, written as any layout wants them.
//! Used by unit tests and, by path, by integration tests.

#![allow(dead_code, reason = "not every test binary uses every helper")]
#![allow(clippy::unwrap_used, reason = "helpers of tests: failing loudly is their job")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use bailando::motion::{Animation, Positions, Skeleton, forward};
use glam::{Quat, Vec3};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Rate of [`clicks`] in Hz.
const AUDIO_HZ: u32 = 16_000;

/// Frames of the motions of [`TestFolder::good`].
pub(crate) const FRAMES: usize = 600;

/// A folder in our own layout that a test may spoil before it is written.
pub(crate) struct TestFolder {
    folder: TempDir,
    pub(crate) index: Value,
}

impl TestFolder {
    /// Two training motions (the first with two songs) and one test motion of 10 s each, without
    /// any fault.
    pub(crate) fn good(skeleton: &Skeleton) -> Self {
        let mut folder = Self {
            folder: tempfile::tempdir().unwrap(),
            index: json!({
                "joints": skeleton.joints,
                "parents": skeleton.parents,
                "offsets": skeleton.offsets,
                "pieces": [],
            }),
        };
        for (seed, name) in ["one", "two", "three"].into_iter().enumerate() {
            let seed = u32::try_from(seed).unwrap();
            folder.motion(&format!("{name}.npy"), &dance(skeleton, FRAMES, seed));
        }
        folder.piece("one_a", "train", "one.npy", "a.wav", 0.50);
        folder.piece("one_b", "train", "one.npy", "b.wav", 0.46);
        folder.piece("two_a", "train", "two.npy", "c.wav", 0.48);
        folder.piece("three_a", "test", "three.npy", "d.wav", 0.52);
        folder
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn motion(&self, name: &str, positions: &Positions) {
        write_npy(&self.path(name), positions);
    }

    /// Adds a piece with clicks every `period_s`.
    fn piece(&mut self, id: &str, split: &str, motion: &str, audio: &str, period_s: f64) {
        let seconds = FRAMES as f64 / 60.0;
        let song = clicks(seconds, 0.1, Some(period_s));
        fs::write(self.path(audio), song).unwrap();
        let grid: Vec<f64> = (0..50).map(|beat| 0.1 + f64::from(beat) * period_s).collect();
        let grid: Vec<f64> = grid.into_iter().filter(|&beat| beat < seconds).collect();
        self.add(json!({
            "id": id, "style": "sway", "split": split, "frames": FRAMES, "seconds": seconds,
            "motion": motion, "audio": audio, "grid_beats_s": grid, "bpm": 60.0 / period_s,
        }));
    }

    pub(crate) fn add(&mut self, piece: Value) {
        self.index["pieces"].as_array_mut().unwrap().push(piece);
    }

    /// Changes one field of one piece; null takes it out.
    pub(crate) fn set(&mut self, id: &str, field: &str, value: Value) {
        let pieces = self.index["pieces"].as_array_mut().unwrap();
        let piece = pieces.iter_mut().find(|piece| piece["id"] == id).unwrap();
        piece[field] = value;
    }

    /// Writes the index; the folder's path.
    pub(crate) fn write(&self) -> &Path {
        fs::write(self.path("index.json"), self.index.to_string()).unwrap();
        self.folder.path()
    }
}

/// Local rotations and root of a figure that sways, steps and turns; other seeds, other dances.
pub(crate) fn animation(joints: usize, frames: usize, seed: u32) -> Animation {
    let phase = f64::from(seed) * 0.7;
    let wave = |frame: usize, joint: usize, speed: f64| {
        ((frame as f64 / 60.0 * speed + joint as f64 + phase).sin() * 0.3) as f32
    };
    let rotation = |frame, joint| {
        if joint == 0 {
            return Quat::from_rotation_y(wave(frame, 0, 0.8) * 2.0);
        }
        let turn = Vec3::new(wave(frame, joint, 5.0), wave(frame, 3 * joint, 4.0), 0.0);
        Quat::from_scaled_axis(turn)
    };
    Animation {
        fps: 60,
        root: (0..frames)
            .map(|frame| Vec3::new(wave(frame, 1, 3.0), 0.93, wave(frame, 2, 2.0)))
            .collect(),
        rotations: (0..frames)
            .map(|frame| (0..joints).map(|joint| rotation(frame, joint)).collect())
            .collect(),
    }
}

/// That figure's joint positions, standing on the floor.
pub(crate) fn dance(skeleton: &Skeleton, frames: usize, seed: u32) -> Positions {
    let animation = animation(skeleton.joints.len(), frames, seed);
    let mut positions = forward(skeleton, &animation).unwrap();
    for mut pose in positions.outer_iter_mut() {
        let lowest = pose[[10, 1]].min(pose[[11, 1]]);
        for joint in 0..skeleton.joints.len() {
            pose[[joint, 1]] += 0.015 - lowest;
        }
    }
    positions
}

/// Writes positions as NumPy would.
pub(crate) fn write_npy(path: &Path, positions: &Positions) {
    let (frames, joints, axes) = positions.dim();
    let header = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({frames}, {joints}, {axes}), }}\n"
    );
    let length = u16::try_from(header.len()).unwrap().to_le_bytes();
    let mut bytes = [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes()].concat();
    bytes.extend(positions.iter().flat_map(|value| value.to_le_bytes()));
    fs::write(path, bytes).unwrap();
}

/// A WAV of clicks every `period_s` seconds from `first_s` on; silence with no period.
pub(crate) fn clicks(seconds: f64, first_s: f64, period_s: Option<f64>) -> Vec<u8> {
    let rate = f64::from(AUDIO_HZ);
    let mut noise = 1_u32;
    let samples: Vec<u8> = (0..(seconds * rate) as usize)
        .flat_map(|n| {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let since = period_s.map(|period| (n as f64 / rate - first_s).rem_euclid(period));
            let level = since.map_or(0.0, |since| (-since * 60.0).exp() * 0.6);
            let value = f64::from(noise >> 16) / 32_768.0 - 1.0;
            ((value * level * 32_767.0) as i16).to_le_bytes()
        })
        .collect();
    let size = |bytes: usize| u32::try_from(bytes).unwrap().to_le_bytes();
    [
        &b"RIFF"[..],
        &size(36 + samples.len()),
        b"WAVEfmt \x10\0\0\0\x01\0\x01\0",
        &AUDIO_HZ.to_le_bytes(),
        &(2 * AUDIO_HZ).to_le_bytes(),
        b"\x02\0\x10\0data",
        &size(samples.len()),
        &samples,
    ]
    .concat()
}
