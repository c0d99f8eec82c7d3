//! Root motion: from the decoder's columns to world positions (ARCHITECTURE sections 1 and 2).

use ndarray::ArrayView2;

use crate::{animation::Positions, error::MotionError};

/// Returns the world positions `[frames, joints, 3]` in metres of a decoder's output
/// `[frames, 3 * joints]`: root velocity per frame in columns 0..3, joints relative to the root
/// elsewhere.
///
/// `root[0] = start`, `root[i] = root[i-1] + velocity[i-1]`; every other joint is added to the root
/// of its frame. Sums run in float32, as in the reference: golden files are met bit for bit.
///
/// # Errors
/// [`MotionError::Shape`] if the columns are not joints of three, [`MotionError::NotFinite`] for a
/// NaN or an infinity, including a sum that overflows.
pub fn integrate_root(
    decoded: ArrayView2<'_, f32>,
    mut start: [f32; 3],
) -> Result<Positions, MotionError> {
    integrate_from(decoded, &mut start)
}

/// [`integrate_root`] from `root`, which is moved on to the frame after the last.
pub(crate) fn integrate_from(
    decoded: ArrayView2<'_, f32>,
    root: &mut [f32; 3],
) -> Result<Positions, MotionError> {
    let (frames, columns) = decoded.dim();
    if columns == 0 || columns % 3 != 0 {
        return Err(MotionError::Shape {
            expected: "columns in groups of three, x y z per joint".into(),
            got: format!("{columns} columns"),
        });
    }
    let mut positions = Positions::zeros((frames, columns / 3, 3));
    for (row, mut pose) in decoded.outer_iter().zip(positions.outer_iter_mut()) {
        for (axis, coordinate) in root.iter_mut().enumerate() {
            for joint in 1..columns / 3 {
                pose[[joint, axis]] = row[3 * joint + axis] + *coordinate;
            }
            pose[[0, axis]] = *coordinate;
            *coordinate += row[axis];
        }
    }
    check_finite(&positions)?;
    Ok(positions)
}

/// Refuses NaN and infinities, naming the first.
pub(crate) fn check_finite(positions: &Positions) -> Result<(), MotionError> {
    match positions.indexed_iter().find(|(_, v)| !v.is_finite()) {
        Some(((frame, joint, _), _)) => Err(MotionError::NotFinite { frame, joint }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, array};

    use super::*;

    fn integrated(decoded: &Array2<f32>) -> Result<Positions, MotionError> {
        integrate_root(decoded.view(), [0.0, 0.9, 0.0])
    }

    #[test]
    fn velocity_moves_the_next_frame() {
        let decoded = array![
            [1.0, 0.0, -1.0, 0.1, 0.2, 0.3],
            [1.0, 0.5, 0.0, 0.1, 0.2, 0.3],
            [9.0, 9.0, 9.0, 0.0, 0.0, 0.0],
        ];
        let expected = array![
            [[0.0, 0.9, 0.0], [0.1, 1.1, 0.3]],
            [[1.0, 0.9, -1.0], [1.1, 1.1, -0.7]],
            [[2.0, 1.4, -1.0], [2.0, 1.4, -1.0]],
        ];
        assert_eq!(integrated(&decoded).unwrap(), expected);
        let none = integrated(&Array2::zeros((0, 72))).unwrap();
        assert_eq!(none.dim(), (0, 24, 3));
    }

    #[test]
    fn unusable_input_is_refused() {
        let odd = integrated(&Array2::zeros((4, 71)));
        assert!(matches!(odd, Err(MotionError::Shape { .. })));
        let mut poisoned = Array2::zeros((4, 72));
        poisoned[[2, 31]] = f32::NAN;
        let (frame, joint) = (2, 10);
        assert_eq!(integrated(&poisoned), Err(MotionError::NotFinite { frame, joint }));
        let overflow = integrated(&Array2::from_elem((4, 6), f32::MAX));
        assert!(matches!(overflow, Err(MotionError::NotFinite { .. })));
    }
}
