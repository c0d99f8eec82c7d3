//! Standing on the floor: removal of slow vertical drift (DESIGN.md, "Standing on the floor").
//!
//! The root is an integral of predicted velocities, so small errors add up to a slow drift. A
//! dancer's lower foot, however, keeps coming back to the floor. The correction is a smooth curve,
//! fitted so that in short windows all along the motion the 5th percentile of the lower foot's
//! height is where recordings have it. A low percentile ignores jumps: some frames of every window
//! are on the ground.

use crate::{animation::Positions, skeleton::Skeleton};

/// Height of the lower foot joint of a standing dancer, metres (recordings: 0.006 to 0.022).
pub const STANDING_HEIGHT: f32 = 0.015;
/// The height that is held is this quantile of the lower foot's height.
const QUANTILE: f64 = 0.05;
/// Distance between the knots of the correction, and length of the window that each one watches,
/// seconds. Every 5 s hold at least two whole windows; a leap is over within one.
const KNOT_SECONDS: f64 = 5.0 / 3.0;
/// Share of a knot's distance from the line between its neighbours that every round takes back.
/// Without it, low steps at the edges of a window, where its knot has little influence, can drive
/// the knot away and lift the dancer off the floor between them.
const STIFFNESS: f64 = 0.05;
/// Largest error over 5 s that is left alone, metres.
const TOLERATED: f64 = 0.015;
/// Rounds of the search. The first half is for the short windows alone: before they have settled,
/// errors over 5 s would be counted twice.
const ROUNDS: usize = 60;

/// Returns the height of the lower foot joint in every frame, metres.
#[must_use]
pub fn lower_foot_heights(positions: &Positions, skeleton: &Skeleton) -> Vec<f32> {
    let feet = skeleton.foot_joints();
    positions
        .outer_iter()
        .map(|pose| {
            feet.iter()
                .filter_map(|&foot| pose.get([foot, 1]))
                .copied()
                .fold(f32::INFINITY, f32::min)
        })
        .collect()
}

/// Returns the lift of the root in every frame, metres, with which the lower foot, at `heights`
/// metres now, keeps coming down to [`STANDING_HEIGHT`]: a twice continuously differentiable curve
/// (cubic B-spline) whose detail is no finer than seconds.
#[must_use]
pub fn floor_correction(heights: &[f32], fps: u32) -> Vec<f32> {
    if heights.is_empty() || fps == 0 {
        return Vec::new();
    }
    let last = heights.len() - 1;
    let spans = (last as f64 / (KNOT_SECONDS * f64::from(fps))).round() as usize;
    if spans < 2 {
        // Shorter than a window: only the level can be known, not its drift.
        let error = quantile(&mut heights.to_vec()) - f64::from(STANDING_HEIGHT);
        return vec![-error as f32; heights.len()];
    }
    let mut curve = Curve::new(spans, last as f64 / spans as f64);
    let mut corrected = vec![0.0; heights.len()];
    let mut errors = vec![0.0; spans + 1];
    let mut leaning = vec![0.0; spans + 1];
    let mut window = Vec::with_capacity(heights.len());
    for round in 0..ROUNDS {
        for (frame, (value, height)) in corrected.iter_mut().zip(heights).enumerate() {
            *value = (f64::from(*height) + curve.at(frame as f64)) as f32;
        }
        // Of the frames from `start` to `start + length`, in knots.
        let mut error_of = |start: f64, length: f64| {
            let first = (start * curve.spacing).max(0.0).ceil() as usize;
            let end = ((start + length) * curve.spacing) as usize;
            window.clear();
            window.extend(corrected.iter().take(end + 1).skip(first));
            quantile(&mut window) - f64::from(STANDING_HEIGHT)
        };
        for (knot, error) in errors.iter_mut().enumerate() {
            let middle = knot as f64;
            // The ends lack half of their window. Reaching further makes up for some of it, so that
            // a leap does not fill the rest.
            let at_end = knot == 0 || knot == spans;
            let reach = if at_end { 2.0 / 3.0 } else { 0.5 };
            *error = error_of(middle - reach, 2.0 * reach);
            // Jerky motion can hold the quantile in every short window and yet miss it in 5 s.
            let start = (middle - 1.5).clamp(0.0, (spans as f64 - 3.0).max(0.0));
            let whole = error_of(start, 3.0);
            if round > ROUNDS / 2 {
                leaning[knot] += 0.3 * (whole - whole.clamp(-TOLERATED, TOLERATED));
            }
            *error += leaning[knot];
        }
        curve.correct(&errors);
    }
    (0..heights.len()).map(|frame| curve.at(frame as f64) as f32).collect()
}

/// Returns the quantile, interpolated linearly between neighbours; reorders `values`.
fn quantile(values: &mut [f32]) -> f64 {
    if values.is_empty() {
        return f64::from(STANDING_HEIGHT);
    }
    let place = QUANTILE * (values.len() - 1) as f64;
    let (_, &mut at, above) = values.select_nth_unstable_by(place as usize, f32::total_cmp);
    let next = above.iter().copied().min_by(f32::total_cmp).unwrap_or(at);
    f64::from(at) + place.fract() * (f64::from(next) - f64::from(at))
}

/// A uniform cubic B-spline, continued in a straight line beyond its ends.
struct Curve {
    knots: Vec<f64>,
    spacing: f64,
}

impl Curve {
    fn new(spans: usize, spacing: f64) -> Self {
        Self { knots: vec![0.0; spans + 1], spacing }
    }

    fn correct(&mut self, errors: &[f64]) {
        let before = self.knots.clone();
        for (knot, error) in errors.iter().enumerate() {
            self.knots[knot] -= error;
            if let (Some(left), Some(right)) = (knot.checked_sub(1), before.get(knot + 1)) {
                let line = 0.5 * (before[left] + right);
                self.knots[knot] += STIFFNESS * (line - before[knot]);
            }
        }
    }

    fn knot(&self, index: isize) -> f64 {
        let last = self.knots.len() as isize - 1;
        let line =
            |end: isize, inner: isize| 2.0 * self.knots[end as usize] - self.knots[inner as usize];
        if index < 0 {
            line(0, 1)
        } else if index > last {
            line(last, last - 1)
        } else {
            self.knots[index as usize]
        }
    }

    fn at(&self, frame: f64) -> f64 {
        let place = frame / self.spacing;
        let span = (place as usize).min(self.knots.len() - 2);
        let u = place - span as f64;
        let weights = [
            (1.0 - u).powi(3) / 6.0,
            (3.0 * u.powi(3) - 6.0 * u * u + 4.0) / 6.0,
            (-3.0 * u.powi(3) + 3.0 * u * u + 3.0 * u + 1.0) / 6.0,
            u.powi(3) / 6.0,
        ];
        let first = span as isize - 1;
        (first..).zip(weights).map(|(k, w)| w * self.knot(k)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FPS: usize = 60;

    /// Lower foot of a dancer who steps: it rests on the floor between short lifts.
    fn steps(seconds: usize) -> Vec<f32> {
        (0..seconds * FPS)
            .map(|i| STANDING_HEIGHT + 0.04 * (i as f32 * 0.11).sin().max(0.0))
            .collect()
    }

    /// Largest distance of the 5th percentile from the standing height in any 5 s.
    fn worst(heights: &[f32]) -> f32 {
        let windows = heights.windows((5 * FPS).min(heights.len()));
        let errors = windows.map(|window| {
            let mut sorted = window.to_vec();
            sorted.sort_by(f32::total_cmp);
            let place = 0.05 * (sorted.len() - 1) as f32;
            let (low, part) = (place as usize, place.fract());
            let high = sorted[(low + 1).min(sorted.len() - 1)];
            (sorted[low] + part * (high - sorted[low]) - STANDING_HEIGHT).abs()
        });
        errors.fold(0.0, f32::max)
    }

    fn highest(heights: &[f32]) -> f32 {
        heights.iter().copied().fold(0.0, f32::max)
    }

    fn corrected(heights: &[f32]) -> Vec<f32> {
        let lift = floor_correction(heights, FPS as u32);
        heights.iter().zip(lift).map(|(h, l)| h + l).collect()
    }

    #[test]
    fn slow_drifts_are_removed() {
        type Drift = fn(f32) -> f32;
        let drifts: [(&str, Drift); 6] = [
            ("none", |_| 0.0),
            ("level", |_| -0.4),
            ("ramp up", |s| 0.1 * s),
            ("ramp down", |s| -0.15 * s),
            ("slow sine", |s| 0.3 * (s * 0.4).sin()),
            ("growing sine", |s| 0.02 * s * (s * 0.5).cos()),
        ];
        for (name, drift) in drifts {
            for seconds in [6, 10, 31, 60] {
                let mut heights = steps(seconds);
                for (i, h) in heights.iter_mut().enumerate() {
                    *h += drift(i as f32 / FPS as f32);
                }
                let worst = worst(&corrected(&heights));
                assert!(worst < 0.02, "{name}, {seconds} s: {worst} m");
            }
        }
    }

    #[test]
    fn short_motions_and_single_frames_stand_too() {
        for frames in [1, 2, 8, 59, 150, 299] {
            let heights: Vec<f32> = steps(5)[..frames].iter().map(|h| h - 0.7).collect();
            assert!(worst(&corrected(&heights)) < 0.02, "{frames} frames");
        }
        assert!(floor_correction(&[], 60).is_empty());
    }

    #[test]
    fn a_leap_keeps_its_height() {
        let mut heights = steps(20);
        let leap = 10 * FPS..10 * FPS + 54;
        for (i, frame) in leap.clone().enumerate() {
            // Nine tenths of a second in the air, 30 cm high.
            heights[frame] = STANDING_HEIGHT + 0.3 * (i as f32 / 54.0 * std::f32::consts::PI).sin();
        }
        let after = corrected(&heights);
        let top = highest(&after[leap]);
        assert!((top - 0.3 - STANDING_HEIGHT).abs() < 0.02, "{top} m");
        assert!(worst(&after) < 0.02);
    }

    #[test]
    fn rare_low_steps_do_not_lift_the_dancer_between_them() {
        // Feet rest at 3 cm and touch lower for a moment, at every distance.
        for distance in [40, 75, 100, 130, 150, 200] {
            let heights: Vec<f32> =
                (0..30 * FPS).map(|i| if i % distance < 9 { 0.005 } else { 0.03 }).collect();
            let after = corrected(&heights);
            let highest = highest(&after);
            assert!(highest < 0.06, "every {distance} frames: {highest} m");
            assert!(worst(&after) < 0.02);
        }
    }

    #[test]
    fn the_correction_is_slow_and_smooth() {
        let mut heights = steps(30);
        for (i, h) in heights.iter_mut().enumerate() {
            *h += 0.2 * (i as f32 / FPS as f32 * 0.5).sin();
        }
        for three in floor_correction(&heights, FPS as u32).windows(3) {
            let speed = (three[1] - three[0]).abs() * FPS as f32;
            let acceleration = (three[2] - 2.0 * three[1] + three[0]).abs() * (FPS * FPS) as f32;
            assert!(speed < 0.4, "{speed} m/s");
            assert!(acceleration < 1.5, "{acceleration} m/s^2");
        }
    }
}
