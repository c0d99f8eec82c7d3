//! Best-fitting rotations: Davenport's solution of Wahba's problem, and the smallest rotation
//! between two directions.

use glam::{DQuat, DVec3};

/// Jacobi sweeps of a 4 x 4 matrix; convergence is quadratic, five are ample in double precision.
const SWEEPS: usize = 12;
/// Relative distance below which the two largest eigenvalues count as one: the pairs then leave an
/// axis free (all on one line, or none at all).
const AMBIGUOUS: f64 = 1e-9;

/// Returns the rotation `q` that minimises `sum |q * from - to|^2` over the pairs `(from, to)`.
///
/// Davenport: the unit quaternion that maximises the quadratic form of the 4 x 4 matrix built from
/// `sum to from^T` is its dominant eigenvector. It is a proper rotation by construction, so a
/// mirrored pose can't turn the body inside out. Where the pairs leave a choice (degenerate bones),
/// the admissible rotation nearest to `previous` is taken.
pub(crate) fn best_rotation(pairs: impl Iterator<Item = (DVec3, DVec3)>, previous: DQuat) -> DQuat {
    let mut s = [[0.0_f64; 3]; 3];
    for (from, to) in pairs {
        for (row, f) in s.iter_mut().zip(from.to_array()) {
            for (cell, t) in row.iter_mut().zip(to.to_array()) {
                *cell += f * t;
            }
        }
    }
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = s;
    // Order of the unknowns: x y z w.
    let davenport = [
        [xx - yy - zz, xy + yx, xz + zx, yz - zy],
        [xy + yx, yy - xx - zz, yz + zy, zx - xz],
        [xz + zx, yz + zy, zz - xx - yy, xy - yx],
        [yz - zy, zx - xz, xy - yx, xx + yy + zz],
    ];
    let (values, vectors) = symmetric_eigen(davenport);
    let largest = values.iter().copied().fold(f64::MIN, f64::max);
    let scale = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let admissible = |v: &f64| largest - v <= AMBIGUOUS * scale;
    let mut sum = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
    let mut fallback = previous;
    for (_, vector) in values.iter().zip(vectors).filter(|(v, _)| admissible(v)) {
        let [x, y, z, w] = vector;
        let vector = DQuat::from_xyzw(x, y, z, w);
        sum += vector * vector.dot(previous);
        fallback = vector;
    }
    // A single admissible vector at right angles to `previous` projects to nothing.
    if sum.length_squared() > 1e-12 { sum.normalize() } else { fallback.normalize() }
}

/// Returns eigenvalues and unit eigenvectors of a symmetric matrix, by cyclic Jacobi rotations.
fn symmetric_eigen(mut a: [[f64; 4]; 4]) -> ([f64; 4], [[f64; 4]; 4]) {
    // Row i of `vectors` belongs to a[i][i].
    let mut vectors = [[0.0; 4]; 4];
    for (i, row) in vectors.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for _ in 0..SWEEPS {
        for p in 0..3 {
            for q in p + 1..4 {
                rotate(&mut a, &mut vectors, p, q);
            }
        }
    }
    ([a[0][0], a[1][1], a[2][2], a[3][3]], vectors)
}

/// Makes `a[p][q]` zero by one Jacobi rotation.
fn rotate(a: &mut [[f64; 4]; 4], vectors: &mut [[f64; 4]; 4], p: usize, q: usize) {
    if a[p][q] == 0.0 {
        return;
    }
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    // The smaller of the two angles; an overflowing theta gives t = 0, which is right.
    let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let c = t.hypot(1.0).recip();
    let s = t * c;
    let turned = |x: f64, y: f64| (c * x - s * y, s * x + c * y);
    for row in a.iter_mut() {
        (row[p], row[q]) = turned(row[p], row[q]);
    }
    for rows in [&mut *a, vectors] {
        let (mut row_p, mut row_q) = (rows[p], rows[q]);
        for (x, y) in row_p.iter_mut().zip(&mut row_q) {
            (*x, *y) = turned(*x, *y);
        }
        (rows[p], rows[q]) = (row_p, row_q);
    }
    a[p][q] = 0.0;
    a[q][p] = 0.0;
}

/// Returns the smallest rotation that takes the unit vector `rest` to the unit vector `direction`,
/// its twist about `direction` changing by at most `max_twist` radians against `previous`.
///
/// Next to the direction opposite to `rest` the smallest rotation spins arbitrarily fast, and at it
/// it does not exist; there the twist of the previous frame is carried along, and given back at the
/// permitted rate afterwards.
pub(crate) fn smallest_rotation(
    rest: DVec3,
    direction: DVec3,
    previous: Option<DQuat>,
    max_twist: f64,
) -> DQuat {
    let smallest = DQuat::from_rotation_arc(rest, direction);
    let Some(previous) = previous else {
        return smallest;
    };
    let before = (previous * rest).normalize();
    let carried = (DQuat::from_rotation_arc(before, direction) * previous).normalize();
    // Both take `rest` to `direction`, so they differ by a rotation about it.
    let twist = twist_about(direction, smallest * carried.inverse());
    if twist.abs() <= max_twist {
        return smallest;
    }
    let permitted = twist.clamp(-max_twist, max_twist);
    (DQuat::from_axis_angle(direction, permitted) * carried).normalize()
}

/// Returns the angle by which a rotation turns about a unit vector, within half a turn, radians.
pub(crate) fn twist_about(axis: DVec3, rotation: DQuat) -> f64 {
    let rotation = if rotation.w < 0.0 { -rotation } else { rotation };
    2.0 * rotation.xyz().dot(axis).atan2(rotation.w)
}

/// Returns that quaternion of a rotation that lies nearer to `previous`.
pub(crate) fn nearer_sign(rotation: DQuat, previous: DQuat) -> DQuat {
    if rotation.dot(previous) < 0.0 { -rotation } else { rotation }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn angle_between(a: DQuat, b: DQuat) -> f64 {
        2.0 * a.dot(b).abs().min(1.0).acos()
    }

    fn quaternion() -> impl Strategy<Value = DQuat> {
        prop::array::uniform4(-1.0..1.0_f64)
            .prop_filter("not zero", |v| v.iter().map(|x| x * x).sum::<f64>() > 1e-3)
            .prop_map(|v| DQuat::from_array(v).normalize())
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-1.0..1.0_f64).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn recovers_the_rotation_of_exact_pairs(q in quaternion(), previous in quaternion()) {
            let bones = [[0.06, -0.08, -0.02], [-0.06, -0.09, -0.01], [0.0, 0.12, -0.04]];
            let bones = bones.map(DVec3::from_array);
            let found = best_rotation(bones.iter().map(|&b| (b, q * b)), previous);
            prop_assert!(angle_between(found, q) < 1e-6);
        }

        #[test]
        fn no_small_turn_fits_better(
            pairs in prop::collection::vec((vector(), vector()), 3),
            axis in vector(),
        ) {
            prop_assume!(axis.length() > 0.1);
            let errors = |q: DQuat| pairs.iter().map(move |&(f, t)| (q * f - t).length_squared());
            let cost = |q| errors(q).sum::<f64>();
            let best = best_rotation(pairs.iter().copied(), DQuat::IDENTITY);
            for angle in [-0.5, -1e-2, 1e-2, 0.5, 3.0] {
                let other = DQuat::from_axis_angle(axis.normalize(), angle) * best;
                prop_assert!(cost(best) <= cost(other) + 1e-9);
            }
        }

        #[test]
        fn a_line_gets_the_rotation_nearest_to_the_previous(
            q in quaternion(),
            previous in quaternion(),
        ) {
            let line = DVec3::new(0.0, 0.3, 0.0);
            let to = q * line;
            let pairs = [(line, to), (line * 2.0, to * 2.0)];
            let found = best_rotation(pairs.into_iter(), previous);
            prop_assert!((found * line - to).length() < 1e-6);
            let before = (previous * line).normalize();
            let carried = DQuat::from_rotation_arc(before, to.normalize()) * previous;
            let difference = angle_between(found, previous) - angle_between(carried, previous);
            prop_assert!(difference.abs() < 1e-5);
        }
    }

    #[test]
    fn without_pairs_the_previous_rotation_stays() {
        let previous = DQuat::from_rotation_y(1.0);
        let found = best_rotation([(DVec3::ZERO, DVec3::X)].into_iter(), previous);
        assert!(angle_between(found, previous) < 1e-9);
    }

    #[test]
    fn twist_is_bounded_through_the_opposite_direction() {
        let rest = DVec3::NEG_Y;
        let mut previous = None;
        for step in 0..=400 {
            // Passes 0.001 rad beside straight up, where the smallest rotation would spin by almost
            // pi.
            let swing = f64::from(step) / 400.0 * std::f64::consts::TAU;
            let direction = DVec3::new(0.001, -swing.cos(), swing.sin()).normalize();
            let q = smallest_rotation(rest, direction, previous, 0.1);
            assert!((q * rest - direction).length() < 1e-9);
            let turn = previous.map_or(0.0, |last| angle_between(q, last));
            assert!(turn < 0.12, "step {step}: {turn}");
            previous = Some(q);
        }
        let last = previous.unwrap();
        let smallest = DQuat::from_rotation_arc(rest, last * rest);
        let twist = angle_between(last, smallest);
        assert!(twist < 1e-6, "back at rest the twist has been given back: {twist}");
    }

    #[test]
    fn exactly_opposite_is_finite() {
        let q = smallest_rotation(DVec3::X, DVec3::NEG_X, None, 0.5);
        assert!((q * DVec3::X + DVec3::X).length() < 1e-9);
        let again = smallest_rotation(DVec3::X, DVec3::X, Some(q), 0.5);
        assert!(again.is_finite() && (again * DVec3::X - DVec3::X).length() < 1e-9);
    }
}
