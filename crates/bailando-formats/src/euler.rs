//! Quaternions to the three angles of a BVH joint.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DQuat};

/// Cosine of the middle angle below which first and third angle turn about one axis.
const GIMBAL_LOCK: f64 = 1e-5;

/// Returns the angles in radians about y, x and z, for `R = Ry * Rx * Rz`, nearest to `previous`.
///
/// Every rotation has two sets of angles, each with any number of full turns; the nearest is taken
/// so that curves don't jump. At gimbal lock, where only a sum of y and z is determined, z stays.
///
/// This order is locked when x is at a right angle: turning about the vertical, which dancers do
/// all the time, is unlimited and keeps its meaning as a heading.
pub(crate) fn nearest_angles(rotation: DQuat, previous: [f64; 3]) -> [f64; 3] {
    let matrix = DMat3::from_quat(rotation.normalize());
    // Columns are x_axis, y_axis, z_axis; row 1 of R is [cos x sin z, cos x cos z, -sin x].
    let sin_x = (-matrix.z_axis.y).clamp(-1.0, 1.0);
    let cos_x = matrix.z_axis.x.hypot(matrix.z_axis.z);
    let x = sin_x.atan2(cos_x);
    if cos_x < GIMBAL_LOCK {
        let z = previous[2];
        let heading = matrix * DMat3::from_rotation_z(-z);
        let y = (-heading.x_axis.z).atan2(heading.x_axis.x);
        return [unwrapped(y, previous[0]), unwrapped(x, previous[1]), z];
    }
    let y = matrix.z_axis.x.atan2(matrix.z_axis.z);
    let z = matrix.x_axis.y.atan2(matrix.y_axis.y);
    let near = |angles: [f64; 3]| [0, 1, 2].map(|axis| unwrapped(angles[axis], previous[axis]));
    let distance = |angles: [f64; 3]| {
        let squares = angles.iter().zip(previous).map(|(a, p)| (a - p).powi(2));
        squares.sum::<f64>()
    };
    let (one, other) = (near([y, x, z]), near([y + PI, PI - x, z + PI]));
    if distance(one) <= distance(other) { one } else { other }
}

/// Adds the full turns to `angle` that bring it nearest to `target`.
fn unwrapped(angle: f64, target: f64) -> f64 {
    angle + ((target - angle) / TAU).round() * TAU
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use proptest::prelude::*;

    use super::*;

    fn composed([y, x, z]: [f64; 3]) -> DQuat {
        DQuat::from_rotation_y(y) * DQuat::from_rotation_x(x) * DQuat::from_rotation_z(z)
    }

    fn apart(a: DQuat, b: DQuat) -> f64 {
        (a * b.inverse()).xyz().length()
    }

    proptest! {
        #[test]
        fn angles_compose_to_the_rotation(
            y in -7.0..7.0_f64, x in -4.0..4.0_f64, z in -7.0..7.0_f64,
            previous in prop::array::uniform3(-9.0..9.0_f64),
        ) {
            let rotation = composed([y, x, z]);
            prop_assert!(apart(composed(nearest_angles(rotation, previous)), rotation) < 1e-9);
        }

        #[test]
        fn nearby_angles_are_found_again(angles in prop::array::uniform3(-12.0..12.0_f64)) {
            prop_assume!(angles[1].cos().abs() > 1e-3);
            let found = nearest_angles(composed(angles), angles);
            prop_assert!(found.iter().zip(angles).all(|(f, a)| (f - a).abs() < 1e-6));
        }
    }

    #[test]
    fn gimbal_lock_keeps_the_third_angle() {
        for x in [FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2 - 1e-7] {
            let rotation = composed([0.4, x, 1.1]);
            let found = nearest_angles(rotation, [0.3, x, 1.1]);
            assert!(apart(composed(found), rotation) < 1e-5);
            let kept = (found[0] - 0.4).abs() < 1e-4 && (found[2] - 1.1).abs() < 1e-12;
            assert!(kept, "{found:?}");
        }
    }

    #[test]
    fn turning_on_and_bending_through_a_right_angle_never_jumps() {
        let mut previous = [0.0; 3];
        for step in 0..1000 {
            let t = f64::from(step) * 0.02;
            // Spins ten radians about the vertical while a leg swings past 90 degrees.
            let angles = [0.5 * t, 2.2 * (0.7 * t).sin(), 0.0];
            let found = nearest_angles(composed(angles), previous);
            let steady = found.iter().zip(previous).all(|(a, b)| (a - b).abs() < 0.1);
            assert!(steady, "step {step}: {previous:?} then {found:?}");
            previous = found;
        }
    }
}
