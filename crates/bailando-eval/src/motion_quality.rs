//! Flaws that a beat score or a Fréchet distance hides: foot skate, jitter, freezes.

use crate::{
    beats::speed,
    body::{
        FRAMES_PER_SECOND, JOINTS, Pose,
        joint::{L_TOES, R_TOES},
    },
    foot_contact::physical_foot_contact,
};
use bailando_motion::{dance_beats, slow_share};

/// Speeds per window in which freezes are looked for: five seconds.
const WINDOW: usize = 300;
/// Speeds from one such window to the next.
const WINDOW_HOP: usize = 150;
/// A window with this share of slow frames, or more, is sluggish.
const SLUGGISH: f64 = 0.1;
/// A foot is taken to stand while it is in the lowest quarter of its heights.
const STANDING_SHARE: f64 = 0.25;

/// Physical measures of one motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionQuality {
    /// Median horizontal speed of a foot that stands, mean of both, cm/s.
    pub foot_skate: f64,
    /// Physical foot contact score (EDGE); none without acceleration.
    pub physical_foot_contact: Option<f64>,
    /// Mean length of the third derivative, m/s^3.
    pub jerk: f64,
    /// Mean joint speed, m/s.
    pub mean_speed: f64,
    /// Share of frames with a mean joint speed below 0.15 m/s.
    pub slow_frames: f64,
    /// Five-second windows, every 2.5 s; a shorter motion is one.
    pub windows: usize,
    /// Those of them with at least a tenth of slow frames.
    pub sluggish_windows: usize,
    /// Share of slow frames in the slowest window.
    pub slowest_window: f64,
    /// Minima of the smoothed speed per second.
    pub dance_beats_per_second: f64,
}

impl MotionQuality {
    /// Measures a motion of at least 4 frames.
    #[must_use]
    pub fn new(poses: &[Pose]) -> Self {
        let speed = speed(poses);
        let steps = speed.len().max(1) as f64;
        let windows = slow_shares_of_windows(&speed);
        let seconds = poses.len().max(1) as f64 / FRAMES_PER_SECOND;
        Self {
            foot_skate: 0.5 * (foot_skate(poses, L_TOES) + foot_skate(poses, R_TOES)),
            physical_foot_contact: physical_foot_contact(poses),
            jerk: jerk(poses),
            mean_speed: speed.iter().sum::<f64>() / steps * FRAMES_PER_SECOND,
            slow_frames: slow_share(&speed, FRAMES_PER_SECOND),
            windows: windows.len(),
            sluggish_windows: windows.iter().filter(|&&share| share >= SLUGGISH).count(),
            slowest_window: windows.iter().copied().fold(0.0, f64::max),
            dance_beats_per_second: dance_beats(&speed).len() as f64 / seconds,
        }
    }
}

fn slow_shares_of_windows(speed: &[f64]) -> Vec<f64> {
    let share = |window: &[f64]| slow_share(window, FRAMES_PER_SECOND);
    if speed.len() < WINDOW {
        return vec![share(speed)];
    }
    speed.windows(WINDOW).step_by(WINDOW_HOP).map(share).collect()
}

fn jerk(poses: &[Pose]) -> f64 {
    let third = |window: &[Pose], joint: usize| {
        window[3][joint] - 3.0 * window[2][joint] + 3.0 * window[1][joint] - window[0][joint]
    };
    let lengths = poses.windows(4).map(|window| {
        let joints = 0..JOINTS;
        joints.map(|joint| third(window, joint).length()).sum::<f64>()
    });
    let count = poses.len().saturating_sub(3).max(1) * JOINTS;
    lengths.sum::<f64>() / count as f64 * FRAMES_PER_SECOND.powi(3)
}

/// Returns the median speed of a standing foot, cm/s. A foot of constant height always stands.
fn foot_skate(poses: &[Pose], foot: usize) -> f64 {
    let mut heights: Vec<f64> = poses.iter().map(|pose| pose[foot].y).collect();
    heights.sort_by(f64::total_cmp);
    let limit = quantile(&heights, STANDING_SHARE);
    let slides = |stands: &dyn Fn(f64) -> bool| -> Vec<f64> {
        let steps = poses.iter().zip(poses.iter().skip(1));
        let standing = steps.filter(|(_, now)| stands(now[foot].y));
        let slide = standing.map(|(before, now)| {
            let step = now[foot] - before[foot];
            step.x.hypot(step.z) * FRAMES_PER_SECOND * 100.0
        });
        slide.collect()
    };
    let mut speeds = slides(&|height| height < limit);
    if speeds.is_empty() {
        speeds = slides(&|height| height <= limit);
    }
    speeds.sort_by(f64::total_cmp);
    quantile(&speeds, 0.5)
}

/// Returns a quantile of ascending values, linear between neighbours; 0 of none.
fn quantile(ascending: &[f64], share: f64) -> f64 {
    let place = share * ascending.len().saturating_sub(1) as f64;
    let below = place.floor();
    let at = |index: f64| ascending.get(index as usize).copied();
    match (at(below), at(below + 1.0)) {
        (Some(one), Some(next)) => one + (place - below) * (next - one),
        (Some(one), None) => one,
        (None, _) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::testing::within;

    fn poses(frames: usize, place: impl Fn(f64, usize) -> DVec3) -> Vec<Pose> {
        let time = |frame: usize| frame as f64 / FRAMES_PER_SECOND;
        let pose = |frame| std::array::from_fn(|joint| place(time(frame), joint));
        (0..frames).map(pose).collect()
    }

    fn close(got: f64, expected: f64) {
        within(1e-6, got, expected);
    }

    #[test]
    fn jerk_is_the_third_derivative() {
        let cubic = poses(60, |t, _| DVec3::new(t.powi(3), t * t, 0.0));
        close(MotionQuality::new(&cubic).jerk, 6.0);
    }

    #[test]
    fn speed_is_per_second_and_slow_is_below_15_cm_a_second() {
        let walk = poses(61, |t, _| DVec3::X * if t < 0.5 { 0.1 * t } else { t - 0.45 });
        let quality = MotionQuality::new(&walk);
        close(quality.mean_speed, 0.55);
        close(quality.slow_frames, 0.5);
    }

    #[test]
    fn a_stop_of_two_seconds_makes_windows_sluggish() {
        // 20 s with a stop from 10.5 to 12.5 s: windows that begin at 7.5 and 10 s hold all of it.
        let stopped = poses(1201, |t, _| DVec3::X * (t - (t - 10.5).clamp(0.0, 2.0)));
        let quality = MotionQuality::new(&stopped);
        assert_eq!((quality.windows, quality.sluggish_windows), (7, 2));
        close(quality.slowest_window, 0.4);
        let short = poses(61, |t, _| DVec3::X * t);
        let quality = MotionQuality::new(&short);
        assert_eq!((quality.windows, quality.sluggish_windows), (1, 0));
    }

    #[test]
    fn a_foot_skates_while_it_is_low() {
        // For a quarter and a bit of the time low and slow, otherwise high and fast.
        let step = poses(101, |t, joint| {
            let low = t < 0.5;
            let x = if low { 0.2 * t } else { 3.0 * t };
            let side = if joint == R_TOES { 2.0 } else { 1.0 };
            DVec3::new(side * x, if low { 0.02 + 0.001 * t } else { 0.2 }, 0.0)
        });
        close(MotionQuality::new(&step).foot_skate, 0.5 * (20.0 + 40.0));
        let sliding = poses(50, |t, _| DVec3::Z * t);
        close(MotionQuality::new(&sliding).foot_skate, 100.0);
    }

    #[test]
    fn quantiles_are_linear() {
        let four = [1.0, 2.0, 3.0, 5.0];
        let found = [(&four[..], 0.25), (&four, 0.5), (&[4.0], 0.25), (&[], 0.5)];
        let found = found.map(|(values, share)| quantile(values, share));
        assert_eq!(found, [1.75, 2.5, 4.0, 0.0]);
    }

    #[test]
    fn dance_beats_are_counted_per_second() {
        let sway = poses(601, |t, _| DVec3::X * (std::f64::consts::TAU * t + 0.05).sin());
        // The speed of a sine of one hertz has two minima a second, ends aside.
        close(MotionQuality::new(&sway).dance_beats_per_second, 20.0 / (601.0 / 60.0));
    }
}
