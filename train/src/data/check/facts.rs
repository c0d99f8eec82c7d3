//! Measures of a motion, without judgement.

use bailando::motion::{Positions, Skeleton};
use ndarray::ArrayView2;

use crate::data::FPS;

const PELVIS: usize = 0;
const HIPS: [usize; 2] = [1, 2];
const ANKLES: [usize; 2] = [7, 8];
const FEET: [usize; 2] = [10, 11];
const HEAD: usize = 15;

/// One frame's measures come from every n-th frame: enough for means, and fast on long motions.
const SPARSE: usize = 4;

type Vector = [f64; 3];

/// A motion in numbers. Lengths are in the file's own unit until `scale` says which.
#[derive(Clone, Debug)]
pub(super) struct MotionFacts {
    pub(super) frames: usize,
    /// First frame with a value that is no number.
    pub(super) not_finite: Option<usize>,
    /// Median over the bones of mean length by expected length: 1 for metres.
    pub(super) scale: f64,
    /// Mean direction from feet to head, length up to 1.
    pub(super) up: Vector,
    /// Share of frames in which the left hip lies right of where the feet point.
    pub(super) swapped: f64,
    /// Largest change of a bone's length along time, by its mean, and the bone's joint.
    pub(super) bone_change: (f64, usize),
    /// Largest difference of a bone's mean length from the skeleton's, in units, and its joint.
    pub(super) bone_difference: (f64, usize),
    /// Mean speed over joints and frames, units per second.
    pub(super) speed: f64,
    /// Fastest step: units per second, frame, joint.
    pub(super) fastest: (f64, usize, usize),
    /// Fastest step of the pelvis, units per second.
    pub(super) root_fastest: f64,
    /// Share of frames that repeat the one before.
    pub(super) repeated: f64,
    /// 5th percentile of the lower foot's height, units.
    pub(super) floor: f64,
}

/// Measures a motion.
pub(super) fn measure(positions: &Positions, skeleton: &Skeleton) -> MotionFacts {
    let frames = positions.dim().0;
    let not_finite =
        positions.outer_iter().position(|pose| pose.iter().any(|value| !value.is_finite()));
    let mut facts = MotionFacts {
        frames,
        not_finite,
        scale: 1.0,
        up: [0.0, 1.0, 0.0],
        swapped: 0.0,
        bone_change: (0.0, 0),
        bone_difference: (0.0, 0),
        speed: 0.0,
        fastest: (0.0, 0, 0),
        root_fastest: 0.0,
        repeated: 0.0,
        floor: 0.0,
    };
    if frames > 0 && not_finite.is_none() {
        facts.measure_bones(positions, skeleton);
        facts.measure_posture(positions);
        facts.measure_speed(positions);
        facts.floor = floor(positions);
    }
    facts
}

impl MotionFacts {
    fn measure_bones(&mut self, positions: &Positions, skeleton: &Skeleton) {
        let mut ratios = Vec::new();
        for (joint, offset) in skeleton.offsets.iter().enumerate() {
            let Some(parent) = skeleton.parent(joint) else {
                continue;
            };
            let lengths: Vec<f64> = positions
                .outer_iter()
                .step_by(SPARSE)
                .map(|pose| length(difference(at(pose, joint), at(pose, parent))))
                .collect();
            let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
            let expected = length(offset.map(f64::from));
            let change = lengths.iter().map(|length| (length - mean).abs());
            let change = change.fold(0.0, f64::max) / mean.max(1e-9);
            if change > self.bone_change.0 {
                self.bone_change = (change, joint);
            }
            let difference = (mean - expected).abs();
            if difference > self.bone_difference.0 {
                self.bone_difference = (difference, joint);
            }
            if expected > 0.0 {
                ratios.push(mean / expected);
            }
        }
        self.scale = median(&mut ratios);
    }

    fn measure_posture(&mut self, positions: &Positions) {
        let (mut up, mut swapped, mut count) = ([0.0; 3], 0.0, 0.0);
        for pose in positions.outer_iter().step_by(SPARSE) {
            let ankles = middle(pose, ANKLES);
            let body = difference(at(pose, HEAD), ankles);
            for (sum, value) in up.iter_mut().zip(body) {
                *sum += value / length(body).max(1e-9);
            }
            let forward = difference(middle(pose, FEET), ankles);
            let [left, right] = HIPS.map(|hip| at(pose, hip));
            // y up and facing +z the left side is at +x: left = up x forward.
            if dot(cross(body, forward), difference(left, right)) < 0.0 {
                swapped += 1.0;
            }
            count += 1.0;
        }
        self.up = up.map(|sum| sum / count);
        self.swapped = swapped / count;
    }

    fn measure_speed(&mut self, positions: &Positions) {
        let (frames, joints, _) = positions.dim();
        let (mut sum, mut repeated) = (0.0, 0_usize);
        let later = positions.outer_iter().enumerate().skip(1);
        for (before, (frame, now)) in positions.outer_iter().zip(later) {
            let mut moved = false;
            for joint in 0..joints {
                let step = length(difference(at(now, joint), at(before, joint)));
                let speed = step * FPS as f64;
                sum += speed;
                moved |= step > 0.0;
                if speed > self.fastest.0 {
                    self.fastest = (speed, frame, joint);
                }
                if joint == PELVIS {
                    self.root_fastest = self.root_fastest.max(speed);
                }
            }
            repeated += usize::from(!moved);
        }
        let steps = frames.saturating_sub(1).max(1) as f64;
        self.speed = sum / (steps * joints as f64);
        self.repeated = repeated as f64 / steps;
    }
}

fn floor(positions: &Positions) -> f64 {
    let lower = positions.outer_iter().map(|pose| {
        let [left, right] = FEET.map(|foot| at(pose, foot)[1]);
        left.min(right)
    });
    let mut heights: Vec<f64> = lower.collect();
    heights.sort_by(f64::total_cmp);
    heights.get(heights.len() / 20).copied().unwrap_or(0.0)
}

fn at(pose: ArrayView2<'_, f32>, joint: usize) -> Vector {
    [0, 1, 2].map(|axis| pose.get((joint, axis)).map_or(0.0, |&value| f64::from(value)))
}

fn middle(pose: ArrayView2<'_, f32>, joints: [usize; 2]) -> Vector {
    let [a, b] = joints.map(|joint| at(pose, joint));
    [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0, (a[2] + b[2]) / 2.0]
}

fn difference(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(vector: Vector) -> f64 {
    dot(vector, vector).sqrt()
}

pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
