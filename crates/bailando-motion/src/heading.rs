//! Motion in the dancer's own frame: every pose turned to head for +z, the way over the floor in
//! steps forward and to the left, and a rate of turning beside them. Models that learn this see the
//! same movement in every direction of the floor.

use std::f32::consts::{PI, TAU};

use glam::Vec3;
use ndarray::{Array2, ArrayView2, ArrayViewMut1};

use crate::{animation::Positions, error::MotionError};

/// SMPL joints whose line across the body gives its heading: left and right of hips, shoulders.
const ACROSS: [(usize, usize); 2] = [(1, 2), (16, 17)];
/// A line across the body shorter than this on the floor (metres, hips and shoulders together)
/// gives no heading: lying on the side.
const SHORTEST: f32 = 0.05;

/// Returns the number of columns in the dancer's frame: three per joint, and the rate of turning.
pub(crate) const fn dancer_columns(joints: usize) -> usize {
    3 * joints + 1
}

/// Returns the heading of each pose: the angle about +y, in radians, that turns +z there; without
/// jumps.
///
/// A pose without a heading keeps that of the frame before; missing joints give none.
#[must_use]
pub fn headings(positions: &Positions) -> Vec<f32> {
    let mut heading = 0.0_f32;
    let frames = positions.outer_iter();
    let angles = frames.map(|pose| {
        let difference = |axis: usize| -> f32 {
            let at = |joint| pose.get([joint, axis]).copied().unwrap_or(0.0);
            ACROSS.iter().map(|&(left, right)| at(left) - at(right)).sum()
        };
        let (x, z) = (difference(0), difference(2));
        if x.hypot(z) >= SHORTEST {
            heading += wrapped((-z).atan2(x) - heading);
        }
        heading
    });
    angles.collect()
}

/// Turns world positions `[frames, joints, 3]` into `[frames, 3 * joints + 1]`.
///
/// Columns 0..3 hold the root's velocity (metres per frame), the next ones the other joints
/// relative to the root, both turned so that their frame heads for +z; the last column holds the
/// turn (radians) to the next frame. The last frame repeats the velocity and turn of the one
/// before.
///
/// # Errors
/// [`MotionError::Shape`] for a motion without the joints that give a heading.
pub fn to_dancer_frame(positions: &Positions) -> Result<Array2<f32>, MotionError> {
    let (frames, joints, axes) = positions.dim();
    let needed = ACROSS.iter().flat_map(|&(left, right)| [left, right]).max();
    if axes != 3 || Some(joints) <= needed {
        return Err(MotionError::Shape {
            expected: "SMPL joints of three coordinates".into(),
            got: format!("{joints} joints of {axes}"),
        });
    }
    let headings = headings(positions);
    let place =
        |frame, joint| Vec3::from_array([0, 1, 2].map(|axis| positions[[frame, joint, axis]]));
    let mut columns = Array2::zeros((frames, dancer_columns(joints)));
    for (frame, mut row) in columns.outer_iter_mut().enumerate() {
        let from = frame.min(frames.saturating_sub(2));
        let to = (from + 1).min(frames - 1);
        let velocity = place(to, 0) - place(from, 0);
        write_joint(&mut row, 0, turned(velocity, -headings[from]));
        for joint in 1..joints {
            let relative = place(frame, joint) - place(frame, 0);
            write_joint(&mut row, joint, turned(relative, -headings[frame]));
        }
        row[3 * joints] = headings[to] - headings[from];
    }
    Ok(columns)
}

/// Turns motion in the dancer's frame `[frames, 3 * joints + 1]` into `[frames, 3 * joints]` with
/// the root's velocity and the relative joints in world directions, the first frame heading for +z.
///
/// # Errors
/// [`MotionError::Shape`] if the columns are not joints of three and a turn.
pub fn to_world_frame(columns: ArrayView2<'_, f32>) -> Result<Array2<f32>, MotionError> {
    turn_from(columns, &mut 0.0)
}

/// [`to_world_frame`] from `heading`, which is turned on to the frame after the last.
pub(crate) fn turn_from(
    columns: ArrayView2<'_, f32>,
    heading: &mut f64,
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
        let angle = *heading as f32;
        for joint in 0..width / 3 {
            let value = Vec3::from_array([0, 1, 2].map(|axis| row[3 * joint + axis]));
            write_joint(&mut out, joint, turned(value, angle));
        }
        // A long motion turns thousands of times over: the sum is kept short and exact.
        *heading = (*heading + f64::from(row[width - 1])).rem_euclid(f64::from(TAU));
    }
    Ok(world)
}

fn write_joint(row: &mut ArrayViewMut1<'_, f32>, joint: usize, value: Vec3) {
    for axis in 0..3 {
        row[3 * joint + axis] = value[axis];
    }
}

/// Turns a vector about +y: +z goes towards +x.
fn turned(Vec3 { x, y, z }: Vec3, angle: f32) -> Vec3 {
    let (sin, cos) = angle.sin_cos();
    Vec3::new(cos * x + sin * z, y, cos * z - sin * x)
}

/// Returns the same angle in `-pi..pi`.
fn wrapped(angle: f32) -> f32 {
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate_root;

    /// Heading of the dancer below, less where it starts.
    fn heading_at(frame: usize) -> f32 {
        let time = frame as f32 / 60.0;
        4.0 * time + 0.3 * (5.0 * time).sin()
    }

    /// A body that turns three times, bends, and walks a curve.
    fn dancer(turned_by: f32) -> Positions {
        let rest = |joint: usize| match joint {
            0 => Vec3::ZERO,
            1 | 16 => Vec3::new(0.1, 0.3, 0.0),
            2 | 17 => Vec3::new(-0.1, 0.3, 0.0),
            _ => Vec3::new(0.0, joint as f32 * 0.05, 0.02 * joint as f32),
        };
        Positions::from_shape_fn((300, 24, 3), |(frame, joint, axis)| {
            let time = frame as f32 / 60.0;
            let root = Vec3::new(time.sin(), 0.9 + 0.1 * time.cos(), 0.4 * time);
            let relative = turned(rest(joint), turned_by + heading_at(frame));
            (turned(root, turned_by) + relative)[axis]
        })
    }

    #[test]
    fn headings_follow_turns_without_jumps() {
        for (frame, heading) in headings(&dancer(0.0)).into_iter().enumerate() {
            assert!((heading - heading_at(frame)).abs() < 1e-4);
        }
    }

    #[test]
    fn there_and_back_is_the_same_motion() {
        let positions = dancer(0.0);
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
        let plain = to_dancer_frame(&dancer(0.0)).unwrap();
        let turned = to_dancer_frame(&dancer(2.0)).unwrap();
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
    fn a_body_on_its_side_keeps_its_heading() {
        let mut positions = dancer(0.0);
        for joint in [1, 2, 16, 17] {
            for axis in 0..3 {
                positions[[150, joint, axis]] = if axis == 1 { joint as f32 } else { 0.0 };
            }
        }
        let found = headings(&positions);
        assert_eq!(found[150], found[149]);
    }
}
