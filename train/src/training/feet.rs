//! Feet that stand, in recordings.

use bailando::motion::Positions;
use ndarray::ArrayView1;

use crate::data::FPS;

/// Balls of the feet, left and right, SMPL order.
pub(super) const FEET: [usize; 2] = [10, 11];
/// Highest place of a ball that stands, metres: 3.6 cm in the street set, lower in the salsa set.
const HIGHEST: f32 = 0.05;
/// Quickest way of one, metres a second: recordings let standing feet slide a little.
const QUICKEST: f32 = 0.3;

/// Returns whether each foot stands from a frame to the next, left and right.
pub(super) fn contacts(positions: &Positions) -> Vec<[bool; 2]> {
    let frames = positions.outer_iter();
    let pairs = frames.zip(positions.outer_iter().skip(1));
    let stands = |now: ArrayView1<'_, f32>, next: ArrayView1<'_, f32>| {
        let squares = now.iter().zip(next).map(|(now, next)| (next - now) * (next - now));
        let way = squares.sum::<f32>().sqrt();
        now[1].max(next[1]) < HIGHEST && way * (FPS as f32) < QUICKEST
    };
    pairs.map(|(now, next)| FEET.map(|foot| stands(now.row(foot), next.row(foot)))).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::data::JOINTS;

    const COUNT: usize = 40;

    /// A body that walks and turns; its left ball stands still at first, its right one slides.
    pub(in crate::training) fn positions() -> Positions {
        Positions::from_shape_fn((COUNT, JOINTS, 3), |(frame, joint, axis)| {
            let time = frame as f32 / FPS as f32;
            let lifted = 0.2 * f32::from(u8::from(frame >= 20));
            let (sin, cos) = (0.8 * time).sin_cos();
            let side = 0.2 * f32::from(i8::from(joint % 3 == 1) - i8::from(joint % 3 == 2));
            match (joint, axis) {
                (10, _) => [0.1, 0.03 + lifted, 0.0][axis],
                (11, _) => [-0.1 - 0.5 * time, 0.03, 0.0][axis],
                (_, 0) => 0.4 * time + side * cos,
                (_, 1) => 0.9 + joint as f32 * 0.02,
                _ => 0.3 * time - side * sin,
            }
        })
    }

    #[test]
    fn a_foot_stands_where_it_is_low_and_slow() {
        let found = contacts(&positions());
        assert_eq!(found.len(), COUNT - 1);
        assert_eq!((found[0], found[18]), ([true, false], [true, false]));
        assert_eq!((found[19], found[30]), ([false; 2], [false; 2]));
    }
}
