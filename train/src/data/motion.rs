//! A motion as the networks take it (ARCHITECTURE section 1).

use bailando::motion::Positions;
use ndarray::{Array2, Axis};

use super::JOINTS;

/// Joint positions of one dance: metres, y up, 60 frames per second, `[T, 24, 3]` in world space.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    positions: Positions,
}

impl Motion {
    /// Takes positions whose shape the readers have checked.
    pub(crate) fn new(positions: Positions) -> Self {
        Self { positions }
    }

    /// World positions `[T, 24, 3]`.
    #[must_use]
    pub fn positions(&self) -> &Positions {
        &self.positions
    }

    /// The world positions alone.
    pub(crate) fn into_positions(self) -> Positions {
        self.positions
    }

    /// Number of frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.positions.len_of(Axis(0))
    }

    /// `[T, 72]`, joint-major: every joint minus the pelvis of its frame; columns 0..3 are zero.
    #[must_use]
    pub fn root_relative(&self) -> Array2<f32> {
        let mut columns = Array2::zeros((self.frames(), 3 * JOINTS));
        for (pose, mut row) in self.positions.outer_iter().zip(columns.outer_iter_mut()) {
            for ((joint, axis), &value) in pose.indexed_iter() {
                if let (Some(cell), Some(root)) =
                    (row.get_mut(3 * joint + axis), pose.get((0, axis)))
                {
                    *cell = value - root;
                }
            }
        }
        columns
    }

    /// `[T, 72]` as a decoder gives it (ARCHITECTURE section 2): the root's velocity in columns
    /// 0..3, the other joints relative to the root.
    #[must_use]
    pub fn decoded(&self) -> Array2<f32> {
        let mut columns = self.root_relative();
        for (place, &step) in self.root_velocity().indexed_iter() {
            if let Some(cell) = columns.get_mut(place) {
                *cell = step;
            }
        }
        columns
    }

    /// `[T, 3]` in metres per frame: `V_t = root[t+1] - root[t]`, the last one repeated.
    #[must_use]
    pub fn root_velocity(&self) -> Array2<f32> {
        let frames = self.frames();
        // The last step there is; a single frame does not move.
        let last = frames.saturating_sub(2);
        let root = |frame, axis| self.positions.get((frame, 0, axis)).copied();
        Array2::from_shape_fn((frames, 3), |(frame, axis)| {
            let step = frame.min(last);
            match (root(step, axis), root(step + 1, axis)) {
                (Some(here), Some(next)) => next - here,
                _ => 0.0,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use bailando::motion::integrate_root;

    use super::*;

    fn wave(frames: usize) -> Motion {
        Motion::new(Positions::from_shape_fn((frames, JOINTS, 3), |(t, j, a)| {
            ((t * (a + 1)) as f32 / 9.0).sin() + j as f32 / 10.0
        }))
    }

    #[test]
    fn columns_and_velocity_integrate_back_to_the_motion() {
        let motion = wave(50);
        let velocity = motion.root_velocity();
        assert_eq!(velocity.row(49), velocity.row(48));
        assert!(motion.root_relative().columns().into_iter().take(3).flatten().all(|&v| v == 0.0));
        let decoded = motion.decoded();
        let start = [0, 1, 2].map(|axis| motion.positions()[[0, 0, axis]]);
        let integrated = integrate_root(decoded.view(), start).unwrap();
        let worst = (&integrated - motion.positions()).mapv(f32::abs);
        assert!(worst.iter().all(|&difference| difference < 1e-5));
        assert_eq!(wave(1).root_velocity().dim(), (1, 3));
    }
}
