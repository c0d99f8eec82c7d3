//! Physical foot contact score (Tseng et al., "EDGE", CVPR 2023, section 4): acceleration of the
//! body that no standing foot explains.

use glam::DVec3;

use crate::body::{
    Pose,
    joint::{L_ANKLE, L_TOES, R_ANKLE, R_TOES, ROOT},
};

/// Frames of ours per frame of the published protocol, which has 30 a second.
const STRIDE: usize = 2;
/// Seconds of such a frame.
const FRAME: f64 = 1.0 / 30.0;
/// Published scores are in cm^2 of foot movement a frame, not m^2.
const SQUARE_CENTIMETRES: f64 = 1e4;

/// Returns the physical foot contact score of poses at 60 frames a second; lower is better.
/// None for a motion of fewer than three frames at 30 a second, or without any acceleration.
///
/// Mean over frames of `|a| |left| |right| / max |a|`: `a` is the root's acceleration, of which
/// only the upward part counts vertically (gravity explains the other); `left` and `right` are how
/// far each foot moves on the floor until the next frame, the ankle or the ball, whichever is less.
pub(crate) fn physical_foot_contact(poses: &[Pose]) -> Option<f64> {
    let frames: Vec<&Pose> = poses.iter().step_by(STRIDE).collect();
    let moments = frames.windows(3).map(|window| {
        let [before, now, after] = [0, 1, 2].map(|frame| window[frame]);
        let acceleration = (after[ROOT] - 2.0 * now[ROOT] + before[ROOT]) / (FRAME * FRAME);
        let upwards = DVec3 { y: acceleration.y.max(0.0), ..acceleration };
        let slide = |joint: usize| {
            let step = after[joint] - now[joint];
            step.x.hypot(step.z)
        };
        let foot = |ankle, ball| slide(ankle).min(slide(ball));
        (upwards.length(), foot(L_ANKLE, L_TOES) * foot(R_ANKLE, R_TOES))
    });
    let moments: Vec<(f64, f64)> = moments.collect();
    let largest = moments.iter().map(|&(acceleration, _)| acceleration).fold(0.0, f64::max);
    if largest == 0.0 {
        return None;
    }
    let sum: f64 = moments.iter().map(|&(acceleration, feet)| acceleration * feet).sum();
    Some(SQUARE_CENTIMETRES * sum / largest / moments.len() as f64)
}

#[cfg(test)]
mod tests {
    use std::array;

    use super::*;
    use crate::testing::within;

    /// Poses of half a second whose feet slide along x at these speeds (m/s: left ankle, left ball,
    /// right ankle, right ball) while the root follows `root` (seconds).
    fn sliding(feet: [f64; 4], root: impl Fn(f64) -> DVec3) -> Vec<Pose> {
        let pose = |frame: usize| {
            let time = frame as f64 / 60.0;
            array::from_fn(|joint| {
                match [L_ANKLE, L_TOES, R_ANKLE, R_TOES].iter().position(|&foot| foot == joint) {
                    Some(foot) => DVec3::X * feet[foot] * time,
                    None => root(time),
                }
            })
        };
        (0..31).map(pose).collect()
    }

    #[test]
    fn both_feet_have_to_slide_while_the_body_accelerates() {
        let rising = |t: f64| DVec3::Y * t * t;
        // Steady acceleration is 1 of its maximum; feet move 2 and 4 cm a frame of 1/30 s.
        let poses = sliding([0.9, 0.6, 1.2, 1.5], rising);
        within(1e-6, physical_foot_contact(&poses).unwrap(), 2.0 * 4.0);
        let standing = sliding([0.9, 0.0, 1.2, 1.5], rising);
        within(1e-6, physical_foot_contact(&standing).unwrap(), 0.0);
    }

    #[test]
    fn falling_is_no_acceleration_and_neither_is_rest() {
        assert_eq!(physical_foot_contact(&sliding([1.0; 4], |_| DVec3::ZERO)), None);
        let falling = sliding([1.0; 4], |t| DVec3::Y * -4.9 * t * t);
        assert_eq!(physical_foot_contact(&falling), None);
        assert_eq!(physical_foot_contact(&falling[..4]), None);
    }
}
