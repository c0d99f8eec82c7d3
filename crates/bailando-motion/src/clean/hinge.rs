//! Where a limb's hinge points along time.
//!
//! Three joints in a bent limb show the hinge: it is at right angles to both bones. Nearly straight
//! limbs show nothing but noise, and so their hinge is that of the frames around them.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec3};

/// Deviation of the Gaussian that averages the hinge over time, seconds.
const DEVIATION: f64 = 0.06;
/// Reach of the average on either side, seconds.
const REACH: f64 = 0.15;
/// Weight of the frame before, against 1 for a limb bent at a right angle: a limb bent by less than
/// about four degrees keeps its hinge.
const INERTIA: f64 = 0.005;
/// Fastest turn of a hinge about its upper bone, radians a second. The swing of the upper bone adds
/// to it, and forearms of dancers stay below 360 degrees in all.
const FASTEST: f64 = 240.0 / 360.0 * TAU;

/// The angle of one limb's hinge about its upper bone, from where the solver's rotation has it.
#[derive(Clone, Debug)]
pub(super) struct HingeTracker {
    /// Sine and cosine of the angle in each frame, weighted by how clearly it shows.
    seen: Vec<[f64; 2]>,
    weights: Vec<f64>,
    fastest: f64,
    /// Largest angle from the solver's rotation, radians.
    largest: f64,
    continues: bool,
    angle: Option<f64>,
}

impl HingeTracker {
    /// For a motion at `fps`, whose hinge stays within `largest` radians of the solver's rotation,
    /// and begins there if the motion continues another.
    pub(super) fn new(fps: u32, largest: f64, continues: bool) -> Self {
        let fps = f64::from(fps.max(1));
        let weight = |frame: usize| (-0.5 * (frame as f64 / (DEVIATION * fps)).powi(2)).exp();
        Self {
            seen: Vec::new(),
            weights: (0..=(REACH * fps).round() as usize).map(weight).collect(),
            fastest: FASTEST / fps,
            largest,
            continues,
            angle: continues.then_some(0.0),
        }
    }

    /// Frames that must be known after one.
    pub(super) fn lookahead(&self) -> usize {
        self.weights.len() - 1
    }

    /// Takes the next frame: the directions of upper and lower bone, and where the solver has the
    /// hinge.
    pub(super) fn see(&mut self, upper: DVec3, lower: DVec3, solved: DVec3) {
        // As long as the sine of the bend.
        let shown = upper.cross(lower);
        let across = shown.dot(upper.cross(solved));
        self.seen.push([across, shown.dot(solved)].map(|part| part * shown.length()));
    }

    /// Returns the hinge of `frame`, which is asked for in order, for an upper bone that points to
    /// `upper` and a hinge that the solver has at `solved`.
    pub(super) fn at(&mut self, frame: usize, upper: DVec3, solved: DVec3) -> DVec3 {
        let before = self.angle.unwrap_or(0.0);
        let (sin, cos) = before.sin_cos();
        let mut sum = [INERTIA * sin, INERTIA * cos];
        let first = frame.saturating_sub(self.lookahead());
        let end = self.seen.len().min(frame + self.weights.len());
        for (other, seen) in self.seen[..end].iter().enumerate().skip(first) {
            let weight = self.weights[other.abs_diff(frame)];
            sum[0] += weight * seen[0];
            sum[1] += weight * seen[1];
        }
        let wanted = sum[0].atan2(sum[1]).clamp(-self.largest, self.largest);
        // A hinge that may turn all the way round takes the shorter one.
        let mut turn = match self.largest < PI {
            true => wanted - before,
            false => (wanted - before + PI).rem_euclid(TAU) - PI,
        };
        if self.angle.is_some() {
            // Where it begins at rest, it speeds up as long as it looks ahead.
            let begun = (frame + 1) as f64 / self.weights.len() as f64;
            let fastest = self.fastest * if self.continues { begun.min(1.0) } else { 1.0 };
            turn = turn.clamp(-fastest, fastest);
        }
        let angle = before + turn;
        self.angle = Some(angle);
        DQuat::from_axis_angle(upper, angle) * solved
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The hinge's angle about an upper bone along x in every frame, whose lower bone is bent by
    /// `bend` towards `angle`.
    fn tracked(frames: usize, largest: f64, limb: impl Fn(usize) -> (f64, f64)) -> Vec<f64> {
        let mut tracker = HingeTracker::new(60, largest, false);
        for frame in 0..frames {
            let (bend, angle) = limb(frame);
            // About the axis that `angle` turns from y: flexion takes x towards axis x x.
            let axis = DQuat::from_rotation_x(angle) * DVec3::Y;
            let lower = DQuat::from_axis_angle(axis, bend) * DVec3::X;
            tracker.see(DVec3::X, lower, DVec3::Y);
        }
        let angle = |axis: DVec3| axis.dot(DVec3::Z).atan2(axis.dot(DVec3::Y));
        (0..frames).map(|frame| angle(tracker.at(frame, DVec3::X, DVec3::Y))).collect()
    }

    #[test]
    fn a_bent_limb_shows_its_hinge_and_a_straight_one_keeps_it() {
        let noise = |frame: usize| 2.0 * (frame as f64 * 1.7).sin();
        let limb = |frame| if frame < 60 { (1.2, 0.3) } else { (0.01, noise(frame)) };
        // A fifth of a second; within one it forgets, and follows the mean of the noise.
        for angle in tracked(72, PI, limb) {
            assert!((angle - 0.3).abs() < 0.05, "{angle}");
        }
    }

    #[test]
    fn no_hinge_turns_faster_than_it_may() {
        let flips = |frame: usize| (1.0, if frame < 50 { 0.0 } else { 3.0 });
        let angles = tracked(160, PI, flips);
        for pair in angles.windows(2) {
            assert!((pair[1] - pair[0]).abs() < FASTEST / 60.0 + 1e-9);
        }
        assert!((angles[159] - 3.0).abs() < 1e-6);
    }

    #[test]
    fn a_knee_never_points_backwards() {
        let angles = tracked(60, 1.4, |_| (0.3, 3.0));
        assert!(angles.iter().all(|angle| angle.abs() < 1.4 + 1e-9));
    }
}
