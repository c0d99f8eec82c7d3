//! What windows of the GPT's training are conditioned on: rows of a song, and a manner.

use bailando::model::Manner;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{
    config::GptConfig, energy::EnergyScale, manners::Manners, piece::MotionPiece,
    recombine::other_music,
};
use crate::data::{Draw, FRAMES_PER_CODE, rows_beside};

/// What a window is conditioned on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Condition {
    /// The motion that the song goes with, and the song.
    pub(super) dance: usize,
    pub(super) song: usize,
    /// Frames cut off the song's start, and the row beside the first code.
    pub(super) phase: usize,
    pub(super) row: usize,
    pub(super) manner: Manner,
}

impl Condition {
    /// Returns the window's own music, without a manner.
    pub(super) fn own(window: &Draw) -> Self {
        let Draw { dance, song, phase, .. } = *window;
        let row = rows_beside(window.codes(FRAMES_PER_CODE)).start;
        Self { dance, song, phase, row, manner: Manner::default() }
    }

    /// Returns the window's own music and style.
    pub(super) fn with_style(window: &Draw, pieces: &[MotionPiece], manners: &Manners) -> Self {
        // A style that no training motion has is not among the columns.
        let style = pieces[window.dance].facts().style.filter(|_| !manners.styles.is_empty());
        Self { manner: Manner { style, energy: None }, ..Self::own(window) }
    }
}

/// Draws the conditions of training windows.
pub(super) struct Conditions<'a> {
    pub(super) config: &'a GptConfig,
    pub(super) manners: &'a Manners,
    pub(super) energy: Option<&'a EnergyScale>,
}

impl Conditions<'_> {
    /// Draws that of a window: now and then other music that fits as well, or no manner.
    pub(super) fn draw(
        &self,
        window: &Draw,
        pieces: &[MotionPiece],
        random: &mut ChaCha8Rng,
    ) -> Condition {
        let mut condition = Condition::with_style(window, pieces, self.manners);
        let piece = &pieces[window.dance];
        let start = window.phase + window.start;
        condition.manner.energy = self.energy.and_then(|scale| scale.of(piece, start));
        let mut dropped = || random.random_bool(self.config.style_drop);
        if dropped() {
            condition.manner.style = None;
        }
        if dropped() {
            condition.manner.energy = None;
        }
        if self.config.recombine > 0.0 && random.random_bool(self.config.recombine) {
            let other = other_music(window, pieces, self.config.block, random);
            if let Some([dance, song, phase, row]) = other {
                return Condition { dance, song, phase, row, ..condition };
            }
        }
        condition
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use bailando::motion::MotionFrame;
    use ndarray::Array2;

    use super::*;
    use crate::{
        data::{Marks, Phrase, testing},
        export::skeleton,
        training::{Config, piece::PieceFacts, songs::SongRows, windows::generator},
    };

    /// Two motions of a style each, with phrases, counts and a song.
    fn pieces() -> [MotionPiece; 2] {
        [0, 1].map(|style| {
            let positions = testing::dance(&skeleton(0.93), 600, 1);
            let phrase = Phrase { start_frame: 0, name: "a".into() };
            let facts = PieceFacts {
                style: Some(style),
                marks: Marks { phrases: vec![phrase], first_count: 1, ..Marks::default() },
                grid_beats_s: (0..20).map(|beat| f64::from(beat) * 0.5).collect(),
                weight: 1.0,
            };
            let rows = SongRows::new(vec![Arc::new(Array2::zeros((76, 1)))]).unwrap();
            let piece = MotionPiece::from_positions(positions, MotionFrame::Dancer).unwrap();
            piece.with_facts(facts).with_song(rows)
        })
    }

    #[test]
    fn manners_are_dropped_and_music_is_moved_as_often_as_asked() {
        let mut config = Config::parse("").unwrap().gpt;
        let manners = Manners { styles: vec!["a".into(), "b".into()], energy: true };
        let pieces = pieces();
        let scale = EnergyScale::measure(&pieces, (0..300).map(|start| (1, start)), 232);
        let window = Draw { dance: 1, start: 80, ..Draw::default() };
        let drawn = |config: &GptConfig, number: u64| {
            let conditions = Conditions { config, manners: &manners, energy: Some(&scale) };
            conditions.draw(&window, &pieces, &mut generator(number, 0))
        };
        let own = Condition::own(&window);
        assert_eq!((own.dance, own.row, own.manner), (1, 11, Manner::default()));
        let whole = Manner { style: Some(1), energy: scale.of(&pieces[1], 80) };
        assert!(whole.energy.is_some_and(|energy| energy > 0.0 && energy < 1.0));
        assert_eq!(drawn(&config, 3), Condition { manner: whole, ..own });

        (config.style_drop, config.recombine) = (0.25, 0.5);
        let all: Vec<Condition> = (0..400).map(|number| drawn(&config, number)).collect();
        let share = |has: fn(&Condition) -> bool| {
            all.iter().filter(|&condition| has(condition)).count() as f64 / all.len() as f64
        };
        assert!((share(|condition| condition.manner.style.is_none()) - 0.25).abs() < 0.07);
        assert!((share(|condition| condition.manner.energy.is_none()) - 0.25).abs() < 0.07);
        let moved = share(|condition| condition.row != 11);
        assert!((0.2..0.57).contains(&moved), "{moved}");
        // The other style's song is none to move to.
        assert!(all.iter().all(|condition| condition.dance == 1));
        let without = Manners::default();
        let plain = Condition::with_style(&window, &pieces, &without);
        assert_eq!(plain, own);
    }
}
