//! What a window of motion is described by for the recognition of styles.

use glam::DVec3;

use crate::body::{FRAMES_PER_SECOND, JOINTS, Pose, facing, in_dancer_frame, joint::ROOT};

/// Frames of a window: 8 s, some four bars.
pub(super) const WINDOW: usize = 480;
/// Frames from one window to the next: 2 s.
pub(super) const STRIDE: usize = 120;
/// Numbers that describe a window: mean and spread of every joint's place, its speed and
/// acceleration, and the root's speed along the floor, up and down, and about itself.
pub(super) const COLUMNS: usize = JOINTS * 3 * 2 + JOINTS * 2 + 3;

/// Smallest spread or speed that is told from none, m and m/s: half the noise of a marker.
const LEAST: f64 = 0.01;
/// Smallest acceleration that is told from none, m/s^2.
const LEAST_ACCELERATION: f64 = 0.1;

/// Joints of the other side, in SMPL order.
const OTHER_SIDE: [usize; JOINTS] =
    [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22];

/// The motion in a mirror that stands at the dancer's side.
pub(super) fn mirrored(poses: &[Pose]) -> Vec<Pose> {
    let flipped = |place: DVec3| DVec3::new(-place.x, place.y, place.z);
    let one = |pose: &Pose| std::array::from_fn(|joint| flipped(pose[OTHER_SIDE[joint]]));
    poses.iter().map(one).collect()
}

/// Describes the full windows of a motion, one every 2 s; speeds as logarithms, since twice as
/// fast is as different from as fast as half as fast is.
pub(super) fn windows(poses: &[Pose]) -> Vec<[f64; COLUMNS]> {
    let own: Vec<Pose> = poses.iter().map(local).collect();
    let turns: Vec<f64> = poses.windows(2).map(|pair| turn(&pair[0], &pair[1])).collect();
    let starts = (0..(poses.len() + 1).saturating_sub(WINDOW)).step_by(STRIDE);
    let describe = |start: usize| {
        let window = start..start + WINDOW;
        describe(&poses[window.clone()], &own[window], &turns[start..start + WINDOW - 1])
    };
    starts.map(describe).collect()
}

/// In the dancer's frame, but the root at its height.
fn local(pose: &Pose) -> Pose {
    let mut own = in_dancer_frame(pose);
    own[ROOT].y = pose[ROOT].y;
    own
}

/// Angle from one pose's heading to the next one's, radians.
fn turn(one: &Pose, next: &Pose) -> f64 {
    let ((a, b), (c, d)) = (facing(one), facing(next));
    (a * d - b * c).atan2(a * c + b * d).abs()
}

fn describe(poses: &[Pose], own: &[Pose], turns: &[f64]) -> [f64; COLUMNS] {
    let frames = own.len() as f64;
    let mut columns = Vec::with_capacity(COLUMNS);
    let places = |joint: usize| own.iter().map(move |pose| pose[joint]);
    let means: [DVec3; JOINTS] = std::array::from_fn(|joint| places(joint).sum::<DVec3>() / frames);
    columns.extend(means.iter().flat_map(DVec3::to_array));
    for (joint, &mean) in means.iter().enumerate() {
        let squares: DVec3 = places(joint).map(|place| (place - mean).powf(2.0)).sum();
        columns.extend((squares / frames).to_array().map(|square| (square.sqrt() + LEAST).ln()));
    }
    for joint in 0..JOINTS {
        let steps = own.windows(2).map(|pair| (pair[1][joint] - pair[0][joint]).length());
        columns.push(rate(steps, 1, LEAST));
    }
    for joint in 0..JOINTS {
        let steps = own
            .windows(3)
            .map(|triple| (triple[2][joint] - 2.0 * triple[1][joint] + triple[0][joint]).length());
        columns.push(rate(steps, 2, LEAST_ACCELERATION));
    }
    let steps = || poses.windows(2).map(|pair| pair[1][ROOT] - pair[0][ROOT]);
    columns.push(rate(steps().map(|step| step.x.hypot(step.z)), 1, LEAST));
    columns.push(rate(steps().map(|step| step.y.abs()), 1, LEAST));
    columns.push(rate(turns.iter().copied(), 1, LEAST));
    #[expect(clippy::expect_used, reason = "COLUMNS counts them")]
    columns.try_into().expect("as many columns as there are")
}

/// Logarithm of the mean change a second to the power of `order`.
fn rate(steps: impl ExactSizeIterator<Item = f64>, order: i32, least: f64) -> f64 {
    let count = steps.len() as f64;
    (steps.sum::<f64>() / count * FRAMES_PER_SECOND.powi(order) + least).ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{body::joint::L_WRIST, testing::within};

    /// Stands, facing +z; the left hand goes up and down by 30 cm at 1 Hz.
    fn waving(frames: usize) -> Vec<Pose> {
        let pose = |frame: usize| {
            let phase = frame as f64 / FRAMES_PER_SECOND * std::f64::consts::TAU;
            std::array::from_fn(|joint| {
                let side = match joint {
                    1 | 16 => 0.2,
                    2 | 17 => -0.2,
                    _ => 0.0,
                };
                let up = if joint == L_WRIST { 0.3 * phase.sin() } else { 0.0 };
                DVec3::new(3.0 + side, 1.0 + up, -2.0)
            })
        };
        (0..frames).map(pose).collect()
    }

    #[test]
    fn a_window_is_described_by_its_formulas_wherever_it_is() {
        let windows = windows(&waving(WINDOW + STRIDE));
        assert_eq!(windows.len(), 2);
        let window = windows[0];
        let spread = window[JOINTS * 3 + L_WRIST * 3 + 1];
        within(1e-6, spread, (0.3 / 2.0_f64.sqrt() + LEAST).ln());
        // A sine travels four amplitudes a period; the step that would end the window is lacking.
        let last = 0.3 * (std::f64::consts::TAU / FRAMES_PER_SECOND).sin();
        let speed = (8.0 * 4.0 * 0.3 - last) / (WINDOW - 1) as f64 * FRAMES_PER_SECOND;
        within(1e-6, window[JOINTS * 6 + L_WRIST], (speed + LEAST).ln());
        // Mean acceleration of a sine, but for the sampling: 2 pi times its mean speed.
        let acceleration = (4.0 * 0.3 * std::f64::consts::TAU + LEAST_ACCELERATION).ln();
        within(5e-3, window[JOINTS * 7 + L_WRIST], acceleration);
        within(1e-9, window[COLUMNS - 1], LEAST.ln());
        for (one, other) in windows[1].into_iter().zip(window) {
            within(1e-6, one, other);
        }
    }

    #[test]
    fn a_motion_and_its_turn_about_the_vertical_are_described_alike() {
        let poses = waving(WINDOW);
        let turned: Vec<Pose> = poses
            .iter()
            .map(|pose| pose.map(|place| DVec3::new(place.z, place.y, -place.x)))
            .collect();
        for (one, other) in windows(&poses)[0].into_iter().zip(windows(&turned)[0]) {
            within(1e-9, one, other);
        }
    }

    #[test]
    fn the_mirror_waves_the_other_hand() {
        let mirror = mirrored(&waving(WINDOW));
        let right = OTHER_SIDE[L_WRIST];
        assert!(mirror[15][right].y > 1.29 && mirror[15][L_WRIST].y < 1.01);
        assert_eq!(windows(&mirror).len(), 1);
        assert!(windows(&mirror[1..]).is_empty());
    }
}
