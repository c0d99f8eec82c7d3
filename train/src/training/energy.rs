//! How quick a window is among those of its style.

use std::collections::HashMap;

use super::piece::MotionPiece;

/// Speeds of the training windows of each style, ascending, metres a second.
pub(super) struct EnergyScale {
    by_style: HashMap<Option<usize>, Vec<f64>>,
    frames: usize,
}

impl EnergyScale {
    /// Measures windows of `frames` frames, given as a motion and a first frame.
    pub(super) fn measure(
        pieces: &[MotionPiece],
        windows: impl Iterator<Item = (usize, usize)>,
        frames: usize,
    ) -> Self {
        let mut by_style: HashMap<Option<usize>, Vec<f64>> = HashMap::new();
        for (dance, start) in windows {
            let piece = &pieces[dance];
            let speed = piece.speed(start..start + frames);
            by_style.entry(piece.facts().style).or_default().push(speed);
        }
        by_style.values_mut().for_each(|speeds| speeds.sort_by(f64::total_cmp));
        Self { by_style, frames }
    }

    /// Returns the share of its style's windows that are slower than the one from `start` on;
    /// `None` for a style without windows.
    pub(super) fn of(&self, piece: &MotionPiece, start: usize) -> Option<f32> {
        let speeds = self.by_style.get(&piece.facts().style)?;
        let speed = piece.speed(start..start + self.frames);
        let slower = speeds.partition_point(|&other| other < speed);
        Some(slower as f32 / (speeds.len() - 1).max(1) as f32).map(|share| share.min(1.0))
    }
}

#[cfg(test)]
mod tests {
    use bailando::motion::{MotionFrame, Positions};

    use super::*;
    use crate::{data::JOINTS, training::piece::PieceFacts};

    /// Moves faster and faster along x.
    fn piece(style: usize, quick: f32) -> MotionPiece {
        let positions = Positions::from_shape_fn((60, JOINTS, 3), |(frame, _, axis)| {
            if axis == 0 { quick * (frame * frame) as f32 * 1e-4 } else { 0.0 }
        });
        let facts = PieceFacts { style: Some(style), ..PieceFacts::default() };
        MotionPiece::from_positions(positions, MotionFrame::World).unwrap().with_facts(facts)
    }

    #[test]
    fn the_slowest_and_the_quickest_of_a_style_are_0_and_1() {
        let pieces = [piece(0, 1.0), piece(1, 9.0)];
        let windows = [0, 10, 20, 30, 40].map(|start| [(0, start), (1, start)]);
        let scale = EnergyScale::measure(&pieces, windows.into_iter().flatten(), 20);
        for piece in &pieces {
            let found = [0, 10, 20, 40].map(|start| scale.of(piece, start));
            assert_eq!(found, [Some(0.0), Some(0.25), Some(0.5), Some(1.0)]);
        }
        assert_eq!(scale.of(&pieces[0], 11), Some(0.5));
        assert_eq!(scale.of(&piece(2, 1.0), 0), None);
    }
}
