//! Augmentation: mirror images and start phases. Tempo variants and several songs for one dance
//! come as pieces.

use super::{FRAMES_PER_CODE, JOINTS};

/// Start phases: cutting 0 to 7 frames moves every code boundary, cutting 8 repeats the first.
pub const PHASES: usize = FRAMES_PER_CODE;

/// For every SMPL joint the one on the other side; joints of the middle stand for themselves.
const OTHER_SIDE: [usize; JOINTS] =
    [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22];

/// Mirrors a motion: x is negated, left and right joints change places.
#[cfg(test)]
pub(crate) fn mirrored(motion: &super::Motion) -> super::Motion {
    let source = motion.positions();
    super::Motion::new(ndarray::Array3::from_shape_fn(source.dim(), |(frame, joint, axis)| {
        let value = source[[frame, OTHER_SIDE[joint], axis]];
        if axis == 0 { -value } else { value }
    }))
}

/// Returns the source of a column of mirrored motion, and its factor. Columns are x, y, z of each
/// joint and, in the dancer's frame, the turn: a mirror turns the other way, and as it mirrors the
/// facing as well, columns in the dancer's frame are mirrored like those in the world's.
#[must_use]
pub fn mirrored_column(column: usize) -> (usize, f32) {
    let (joint, axis) = (column / 3, column % 3);
    let other = OTHER_SIDE.get(joint).copied().unwrap_or(joint);
    (3 * other + axis, if axis == 0 { -1.0 } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use bailando::motion::to_dancer_frame;

    use super::*;
    use crate::{
        data::{Motion, testing},
        export::skeleton,
    };

    #[test]
    fn sides_change_places_by_name() {
        let names = skeleton(0.9).joints;
        for (joint, name) in names.iter().enumerate() {
            let expected = match name.split_at(2) {
                ("l_", rest) => format!("r_{rest}"),
                ("r_", rest) => format!("l_{rest}"),
                _ => name.clone(),
            };
            assert_eq!(names[OTHER_SIDE[joint]], expected);
        }
    }

    #[test]
    fn a_mirror_twice_is_the_dance_itself() {
        let motion = Motion::new(testing::dance(&skeleton(0.9), 40, 1));
        let once = mirrored(&motion);
        assert_ne!(once, motion);
        assert_eq!(mirrored(&once), motion);
        let left_hand = motion.positions()[[7, 22, 0]];
        assert_eq!(once.positions()[[7, 23, 0]], -left_hand);
        assert_eq!(once.positions()[[7, 23, 1]], motion.positions()[[7, 22, 1]]);
    }

    #[test]
    fn columns_are_mirrored_like_positions_in_both_frames() {
        let motion = Motion::new(testing::dance(&skeleton(0.9), 200, 1));
        let turned = |motion: &Motion| to_dancer_frame(motion.positions()).unwrap();
        for columns in [Motion::root_relative, Motion::root_velocity, turned] {
            let (plain, wanted) = (columns(&motion), columns(&mirrored(&motion)));
            for ((frame, column), wanted) in wanted.indexed_iter() {
                let (source, factor) = mirrored_column(column);
                let found = factor * plain[[frame, source]];
                assert!((found - wanted).abs() < 1e-5, "{column}: {found} {wanted}");
            }
        }
    }
}
