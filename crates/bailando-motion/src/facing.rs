//! Motion in the dancer's own frame: every pose turned to face +z, the way over the floor in steps
//! forward and to the left, and a rate of turning beside them. Models that learn this see the same
//! movement in every direction of the floor.

use std::f32::consts::{PI, TAU};

use ndarray::{Array2, ArrayView2};

use super::{MotionError, Positions};

/// SMPL joints whose line across the body tells where it faces: left and right of hips, shoulders.
const ACROSS: [(usize, usize); 2] = [(1, 2), (16, 17)];
/// A line across the body shorter than this on the floor (metres, hips and shoulders together)
/// tells no direction: lying on the side.
const SHORTEST: f32 = 0.05;

/// Columns of a motion in the dancer's frame: three per joint, and the rate of turning.
#[must_use]
pub const fn facing_columns(joints: usize) -> usize {
    3 * joints + 1
}

/// Where each pose faces: the angle about +y, in radians, that turns +z there; without jumps.
///
/// A pose that tells no direction keeps that of the frame before; joints that are not there tell
/// none.
#[must_use]
pub fn facings(positions: &Positions) -> Vec<f32> {
    let mut facing = 0.0_f32;
    let frames = positions.outer_iter();
    let angles = frames.map(|pose| {
        let difference = |axis: usize| -> f32 {
            let pairs = ACROSS.iter();
            let at = |joint| pose.get([joint, axis]).copied().unwrap_or(0.0);
            pairs.map(|&(left, right)| at(left) - at(right)).sum()
        };
        let (x, z) = (difference(0), difference(2));
        if x.hypot(z) >= SHORTEST {
            facing += wrapped((-z).atan2(x) - facing);
        }
        facing
    });
    angles.collect()
}

/// World positions `[frames, joints, 3]` as `[frames, 3 * joints + 1]`: the root's velocity (metres
/// per frame) in columns 0..3 and the other joints relative to the root, both turned so that their
/// frame faces +z; in the last column the turn (radians) to the next frame. What leads to the next
/// frame is repeated in the last.
///
/// # Errors
/// [`MotionError::Shape`] for a motion without the joints that tell where a body faces.
pub fn to_dancer_frame(positions: &Positions) -> Result<Array2<f32>, MotionError> {
    let (frames, joints, axes) = positions.dim();
    let needed = ACROSS
        .iter()
        .map(|&(left, right)| left.max(right) + 1)
        .max();
    if axes != 3 || joints < needed.unwrap_or(0) {
        return Err(MotionError::Shape {
            expected: "SMPL joints of three coordinates".into(),
            got: format!("{joints} joints of {axes}"),
        });
    }
    let facings = facings(positions);
    let mut columns = Array2::zeros((frames, facing_columns(joints)));
    for (frame, mut row) in columns.outer_iter_mut().enumerate() {
        let root = |frame: usize| std::array::from_fn(|axis| positions[[frame, 0, axis]]);
        let here: [f32; 3] = root(frame);
        let turn = -facings[frame];
        let from = frame.min(frames.saturating_sub(2));
        let to = (from + 1).min(frames - 1);
        let velocity = turned(difference(root(to), root(from)), -facings[from]);
        for joint in 0..joints {
            let value = if joint == 0 {
                velocity
            } else {
                let place = std::array::from_fn(|axis| positions[[frame, joint, axis]]);
                turned(difference(place, here), turn)
            };
            for (axis, value) in value.into_iter().enumerate() {
                row[3 * joint + axis] = value;
            }
        }
        row[3 * joints] = facings[to] - facings[from];
    }
    Ok(columns)
}

/// Motion in the dancer's frame `[frames, 3 * joints + 1]` as `[frames, 3 * joints]` with the root's
/// velocity and the relative joints in world directions, the first frame facing +z.
///
/// # Errors
/// [`MotionError::Shape`] if the columns are not joints of three and a turn.
pub fn to_world_frame(columns: ArrayView2<'_, f32>) -> Result<Array2<f32>, MotionError> {
    turn_on(columns, &mut 0.0)
}

/// [`to_world_frame`] of a piece whose first frame faces `facing`, which is turned on to the frame
/// behind its last.
pub(super) fn turn_on(
    columns: ArrayView2<'_, f32>,
    facing: &mut f64,
) -> Result<Array2<f32>, MotionError> {
    let (frames, width) = columns.dim();
    if width < 4 || width % 3 != 1 {
        return Err(MotionError::Shape {
            expected: "columns in groups of three, x y z per joint, and one of turning".into(),
            got: format!("{width} columns"),
        });
    }
    let mut world = Array2::zeros((frames, width - 1));
    for (row, mut out) in columns.outer_iter().zip(world.outer_iter_mut()) {
        let angle = *facing as f32;
        for joint in 0..width / 3 {
            let value = std::array::from_fn(|axis| row[3 * joint + axis]);
            for (axis, value) in turned(value, angle).into_iter().enumerate() {
                out[3 * joint + axis] = value;
            }
        }
        // A long dance turns thousands of times over: the sum is kept short and exact.
        *facing = (*facing + f64::from(row[width - 1])).rem_euclid(f64::from(TAU));
    }
    Ok(world)
}

fn difference(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

/// Turned about +y: +z goes towards +x.
fn turned([x, y, z]: [f32; 3], angle: f32) -> [f32; 3] {
    let (sin, cos) = angle.sin_cos();
    [cos * x + sin * z, y, cos * z - sin * x]
}

/// The same angle in `-pi..pi`.
fn wrapped(angle: f32) -> f32 {
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate_root;

    /// A body that turns three times, bends, and walks a curve.
    fn dance(turned_by: f32) -> Positions {
        let rest = |joint: usize| -> [f32; 3] {
            match joint {
                1 | 16 => [0.1, 0.3, 0.0],
                2 | 17 => [-0.1, 0.3, 0.0],
                _ => [0.0, joint as f32 * 0.05, 0.02 * joint as f32],
            }
        };
        Positions::from_shape_fn((300, 24, 3), |(frame, joint, axis)| {
            let time = frame as f32 / 60.0;
            let angle = turned_by + 4.0 * time + 0.3 * (5.0 * time).sin();
            let root = turned([time.sin(), 0.9 + 0.1 * time.cos(), 0.4 * time], turned_by);
            let place = if joint == 0 { [0.0; 3] } else { rest(joint) };
            root[axis] + turned(place, angle)[axis]
        })
    }

    #[test]
    fn facings_follow_turns_without_jumps() {
        let found = facings(&dance(0.0));
        for (frame, facing) in found.iter().enumerate() {
            let time = frame as f32 / 60.0;
            assert!((facing - (4.0 * time + 0.3 * (5.0 * time).sin())).abs() < 1e-4);
        }
    }

    #[test]
    fn there_and_back_is_the_same_dance() {
        let positions = dance(0.0);
        let columns = to_dancer_frame(&positions).unwrap();
        let world = to_world_frame(columns.view()).unwrap();
        let start = std::array::from_fn(|axis| positions[[0, 0, axis]]);
        let back = integrate_root(world.view(), start).unwrap();
        for (found, wanted) in back.iter().zip(&positions) {
            assert!((found - wanted).abs() < 1e-3, "{found} {wanted}");
        }
    }

    #[test]
    fn every_direction_of_the_floor_is_the_same() {
        let plain = to_dancer_frame(&dance(0.0)).unwrap();
        let turned = to_dancer_frame(&dance(2.0)).unwrap();
        for (a, b) in plain.iter().zip(&turned) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }

    #[test]
    fn other_shapes_are_refused() {
        assert!(to_dancer_frame(&Positions::zeros((4, 5, 3))).is_err());
        assert!(to_world_frame(Array2::zeros((4, 72)).view()).is_err());
    }

    #[test]
    fn a_body_on_its_side_keeps_its_facing() {
        let mut positions = dance(0.0);
        for joint in [1, 2, 16, 17] {
            for axis in 0..3 {
                positions[[150, joint, axis]] = if axis == 1 { joint as f32 } else { 0.0 };
            }
        }
        let found = facings(&positions);
        assert_eq!(found[150], found[149]);
    }
}
