//! Measures of a motion, without judgement.

use bailando::motion::{Positions, Skeleton};
use glam::DVec3;
use ndarray::ArrayView2;

use crate::data::{FPS, load::broken_frame};

const PELVIS: usize = 0;
const HIPS: [usize; 2] = [1, 2];
const ANKLES: [usize; 2] = [7, 8];
const FEET: [usize; 2] = [10, 11];
const HEAD: usize = 15;

/// One frame's measures come from every n-th frame: enough for means, and fast on long motions.
const SPARSE: usize = 4;

/// A motion in numbers. Lengths are in the file's own unit until `scale` says which.
#[derive(Clone, Debug)]
pub(super) struct MotionFacts {
    pub(super) frames: usize,
    /// First frame with a value that is no number.
    pub(super) not_finite: Option<usize>,
    /// Median over the bones of mean length by expected length: 1 for metres.
    pub(super) scale: f64,
    /// Mean direction from feet to head, length up to 1.
    pub(super) up: DVec3,
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
    /// Height of the pelvis: highest less lowest, units.
    pub(super) root_rise: f64,
    /// Share of frames that repeat the one before.
    pub(super) repeated: f64,
    /// 5th percentile of the lower foot's height, units.
    pub(super) floor: f64,
}

/// Measures a motion.
pub(super) fn measure(positions: &Positions, skeleton: &Skeleton) -> MotionFacts {
    let frames = positions.dim().0;
    let not_finite = broken_frame(positions);
    let mut facts = MotionFacts {
        frames,
        not_finite,
        scale: 1.0,
        up: DVec3::Y,
        swapped: 0.0,
        bone_change: (0.0, 0),
        bone_difference: (0.0, 0),
        speed: 0.0,
        fastest: (0.0, 0, 0),
        root_fastest: 0.0,
        root_rise: 0.0,
        repeated: 0.0,
        floor: 0.0,
    };
    if frames > 0 && not_finite.is_none() {
        facts.measure_bones(positions, skeleton);
        facts.measure_posture(positions);
        facts.measure_speed(positions);
        facts.root_rise = root_rise(positions);
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
                .map(|pose| at(pose, joint).distance(at(pose, parent)))
                .collect();
            let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
            let expected = DVec3::from(offset.map(f64::from)).length();
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
        let (mut up, mut swapped, mut count) = (DVec3::ZERO, 0.0, 0.0);
        for pose in positions.outer_iter().step_by(SPARSE) {
            let ankles = middle(pose, ANKLES);
            let body = at(pose, HEAD) - ankles;
            up += body / body.length().max(1e-9);
            let forward = middle(pose, FEET) - ankles;
            let [left, right] = HIPS.map(|hip| at(pose, hip));
            // y up and heading +z the left side is at +x: left = up x forward.
            if body.cross(forward).dot(left - right) < 0.0 {
                swapped += 1.0;
            }
            count += 1.0;
        }
        self.up = up / count;
        self.swapped = swapped / count;
    }

    fn measure_speed(&mut self, positions: &Positions) {
        let (frames, joints, _) = positions.dim();
        let (mut sum, mut repeated) = (0.0, 0_usize);
        let later = positions.outer_iter().enumerate().skip(1);
        for (before, (frame, now)) in positions.outer_iter().zip(later) {
            let mut moved = false;
            for joint in 0..joints {
                let step = at(now, joint).distance(at(before, joint));
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

fn root_rise(positions: &Positions) -> f64 {
    let heights = positions.outer_iter().map(|pose| at(pose, PELVIS).y);
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), height| {
        (low.min(height), high.max(height))
    });
    high - low
}

fn floor(positions: &Positions) -> f64 {
    let lower = positions.outer_iter().map(|pose| {
        let [left, right] = FEET.map(|foot| at(pose, foot).y);
        left.min(right)
    });
    let mut heights: Vec<f64> = lower.collect();
    heights.sort_by(f64::total_cmp);
    heights.get(heights.len() / 20).copied().unwrap_or(0.0)
}

fn at(pose: ArrayView2<'_, f32>, joint: usize) -> DVec3 {
    let axis = |axis| pose.get((joint, axis)).map_or(0.0, |&value| f64::from(value));
    DVec3::new(axis(0), axis(1), axis(2))
}

fn middle(pose: ArrayView2<'_, f32>, [a, b]: [usize; 2]) -> DVec3 {
    (at(pose, a) + at(pose, b)) / 2.0
}

pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
